"""Quadrics of all poses pulled back to the rest pose."""

import numpy as np
import pytest

import warpqem
from tests.support.meshes import rotation, tube
from tests.support.skin_fit import FACES, POSES, SKIN, TRANSFORMS, error, random_poses
from warpqem.errors import OptionError, UnreachableTargetError
from warpqem.pipeline.surface_transfer import surface_transfer
from warpqem.skinning.linear_skin import LinearSkin, blend_skin, pose_skin
from warpqem.skinning.rest_pose_quadrics import pulled_back_matrices, simplify_pulled_back


def interpolated(result: warpqem.SimplifiedMesh) -> LinearSkin:
    transfer = surface_transfer(POSES[0], FACES, result, device="cpu")
    wedge = transfer.vertex_wedge
    skin = blend_skin(SKIN, transfer.wedge_vertex[wedge], transfer.wedge_weight[wedge])
    return LinearSkin(result.points[0], skin.joints, skin.weights)


def test_rigid_poses_pull_back_to_the_rest_pose_itself():
    points, faces = tube(8, 6)
    skin = LinearSkin(points, np.zeros((len(points), 1), dtype=np.int32), np.ones((len(points), 1)))
    turn = np.concatenate([rotation([1, 2, 3], 0.7), [[0.3], [-1], [2]]], axis=1)
    transforms = np.stack([np.eye(4)[:3], turn])[:, None]
    poses = pose_skin(skin, transforms)
    once = pulled_back_matrices(poses[:1], faces, skin, transforms[:1])
    np.testing.assert_allclose(pulled_back_matrices(poses, faces, skin, transforms), 2 * once, atol=1e-12)


def test_matrix_measures_displacements_of_the_rest_position_in_the_poses():
    # One vertex moved at rest: what its face planes see of it in every pose, its neighbours where they were.
    vertex, step = 100, np.array([2e-3, -1e-3, 3e-3])
    linear = np.einsum("k,pkab->pab", SKIN.weights[vertex], TRANSFORMS[:, SKIN.joints[vertex], :, :3])
    total = 0.0
    for pose, matrix in zip(pose_skin(SKIN, TRANSFORMS), linear, strict=True):
        around = FACES[(vertex == FACES).any(axis=1)]
        cross = np.cross(pose[around[:, 1]] - pose[around[:, 0]], pose[around[:, 2]] - pose[around[:, 0]])
        area = np.linalg.norm(cross, axis=1) / 2
        total += (area * (cross / (2 * area[:, None]) @ (matrix @ step)) ** 2).sum()
    matrices = pulled_back_matrices(pose_skin(SKIN, TRANSFORMS), FACES, SKIN, TRANSFORMS)
    np.testing.assert_allclose(step @ matrices[vertex] @ step, total, rtol=1e-9)


def test_result_is_one_rest_shape_that_poses_well(device):
    result = simplify_pulled_back(POSES, FACES, SKIN, TRANSFORMS, ratio=0.2, device=device)
    assert result.points.shape[0] == 1
    assert len(result.faces) in (round(0.2 * len(FACES)), round(0.2 * len(FACES)) - 1)
    # Within a factor of what the free points of every pose have.
    free = warpqem.simplify(POSES, FACES, ratio=0.2, device=device)
    unseen = random_poses(4, seed=5)
    assert error(interpolated(result), result, unseen) < 2 * error(interpolated(free), free, unseen)


def test_locked_vertices_stay(device):
    result = simplify_pulled_back(POSES, FACES, SKIN, TRANSFORMS, ratio=0.2, locked=[3, 200], device=device)
    np.testing.assert_array_equal(result.points[0, result.vertex_map[[3, 200]]], POSES[0, [3, 200]])


def test_options_without_a_meaning_are_refused():
    with pytest.raises(OptionError, match="coherence, refit: no option"):
        simplify_pulled_back(POSES, FACES, SKIN, TRANSFORMS, ratio=0.2, coherence=0.5, refit=True)


def test_count_that_cannot_be_reached_is_an_error_with_the_result():
    with pytest.raises(UnreachableTargetError, match="1 were asked for") as caught:
        simplify_pulled_back(POSES, FACES, SKIN, TRANSFORMS, target_faces=1, locked=np.arange(656), device="cpu")
    assert len(caught.value.result.faces) == len(FACES)


def test_fins_are_cut_off_and_do_not_block(device):
    edges, tips = FACES[100:110, :2], FACES[300:310, :1]
    with_fins = np.concatenate([FACES, np.concatenate([edges, tips], axis=1)]).astype(FACES.dtype)
    result = simplify_pulled_back(POSES, with_fins, SKIN, TRANSFORMS, ratio=0.05, device=device)
    assert len(result.faces) <= len(with_fins) // 20
    assert result.repair.findings.branching_edges == 10
    assert result.vertex_map.shape == (POSES.shape[1],)
    assert result.vertex_map[np.unique(FACES)].min() >= 0
