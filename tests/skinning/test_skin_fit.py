"""Rest positions and skin weights fitted together over poses."""

from dataclasses import replace

import numpy as np
import pytest

import warpqem
from tests.support.meshes import bumpy_sphere
from tests.support.skin_fit import (
    FACES,
    POSES,
    SKIN,
    TRANSFORMS,
    error,
    random_poses,
    simplified,
)
from warpqem.errors import MeshShapeError, OptionError
from warpqem.kernels.skin_fit import REACH
from warpqem.pipeline.surface_transfer import surface_transfer
from warpqem.skinning.fit_problem import SURFACE_REGULARISATION, WEIGHT_REGULARISATION
from warpqem.skinning.fit_skin import fit_skin
from warpqem.skinning.linear_skin import LinearSkin, blend_influences, blend_skin, normalised_weights, pose_skin


def interpolated(result: warpqem.SimplifiedMesh) -> LinearSkin:
    transfer = surface_transfer(POSES[0], FACES, result, device="cpu")
    wedge = transfer.vertex_wedge
    blended = blend_skin(SKIN, transfer.wedge_vertex[wedge], transfer.wedge_weight[wedge])
    return replace(blended, rest=result.points[0])


def test_fitted_skin_is_nearer_than_an_interpolated_one_in_poses_it_never_saw(result, device):
    unseen = random_poses(8, seed=2)
    fitted = fit_skin(POSES, FACES, result, SKIN, TRANSFORMS, device=device)
    assert error(fitted.skin, result, unseen) < 0.97 * error(interpolated(result), result, unseen)
    assert fitted.after < 0.75 * fitted.before


@pytest.mark.parametrize("influences", [1, 2, 3, None])
def test_weights_are_few_not_negative_and_sum_to_one(result, device, influences):
    skin = fit_skin(POSES, FACES, result, SKIN, TRANSFORMS, influences=influences, device=device).skin
    assert skin.joints.shape == skin.weights.shape == (len(skin.rest), influences or 3)
    assert (skin.weights >= 0).all()
    assert (np.diff(skin.weights, axis=1) <= 0).all()
    np.testing.assert_allclose(skin.weights.sum(axis=1, dtype=np.float64), 1.0, atol=1e-6)


def test_fewer_influences_fit_no_better(result, device):
    after = [fit_skin(POSES, FACES, result, SKIN, TRANSFORMS, influences=k, device=device).after for k in (1, 2, 4)]
    assert after[0] > after[1] > after[2]


def test_weights_are_the_minimum_at_the_position(device):
    # One output vertex: its Gram matrix by NumPy, and the conditions of Karush, Kuhn and Tucker.
    points, faces = bumpy_sphere(1)
    rng = np.random.default_rng(3)
    joints = np.tile(np.arange(4, dtype=np.int32), (len(points), 1))
    weights = rng.dirichlet(np.ones(4), len(points))
    skin = LinearSkin(points, joints, weights)
    poses = pose_skin(skin, TRANSFORMS).astype(np.float32)
    result = warpqem.simplify(poses, faces, target_faces=40, quality="fast", device="cpu")
    fitted = fit_skin(poses, faces, result, skin, TRANSFORMS, influences=4, device=device).skin
    unit = 1.0 / np.linalg.norm(np.ptp(poses[0].astype(np.float64), axis=0))
    start = interpolated_of(skin, poses, faces, result)
    checked = 0
    for vertex in range(len(fitted.rest)):
        if (result.vertex_map == vertex).sum() == 1:
            continue
        gram, linear = normal_equations(poses * unit, faces, result, vertex, fitted.rest[vertex] * unit, start, unit)
        own = np.zeros(4)
        np.add.at(own, fitted.joints[vertex], fitted.weights[vertex])
        slope = gram @ own - linear
        used = own > 1e-6
        # The slope is the same for all joints in use, and not lower for the others.
        assert np.ptp(slope[used]) < 1e-5 * np.trace(gram)
        assert (slope[~used] > slope[used].mean() - 1e-5 * np.trace(gram)).all()
        checked += 1
    assert checked > 5


def interpolated_of(skin, poses, faces, result) -> np.ndarray:
    transfer = surface_transfer(poses[0], faces, result, device="cpu")
    wedge = transfer.vertex_wedge
    blended = blend_skin(skin, transfer.wedge_vertex[wedge], transfer.wedge_weight[wedge], 4)
    dense = np.zeros((len(blended.rest), 4))
    np.put_along_axis(dense, blended.joints, blended.weights, axis=1)
    return dense


def normal_equations(poses, faces, result, vertex, rest, start, unit) -> tuple[np.ndarray, np.ndarray]:
    """``G`` with its regularisation, and the right side, for one output vertex, as the module's docstring says."""
    gram = np.zeros((4, 4))
    for pose, goal, transform in zip(poses, result.points[:, vertex] * unit, TRANSFORMS, strict=True):
        corner = pose[faces].astype(np.float64)
        cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        length = np.linalg.norm(cross, axis=1)
        share = (result.vertex_map[faces] == vertex).sum(axis=1) * 0.5 / length
        matrix = np.einsum("f,fi,fj->ij", share, cross, cross)
        reach = float(REACH) * np.sqrt(np.trace(matrix) / (3 * np.pi))
        matrix += SURFACE_REGULARISATION * np.trace(matrix) * np.eye(3)
        slope = np.einsum("f,fi,f->i", share, cross, np.einsum("fi,fi->f", cross, goal - corner[:, 0]))
        away = np.linalg.solve(matrix, slope)
        goal = goal - away * min(1.0, reach / max(np.linalg.norm(away), 1e-30))
        away = transform[:, :, :3] @ rest + transform[:, :, 3] * unit - goal
        gram += away @ matrix @ away.T
    soft = WEIGHT_REGULARISATION * np.trace(gram) / 4
    return gram + soft * np.eye(4), soft * start[vertex]


@pytest.mark.parametrize("quality", ["fast", "best"])
def test_skin_follows_the_points_of_a_refitted_result_only(quality, device):
    result = simplified(quality=quality)
    assert result.refitted == (quality == "best")
    given = (POSES, FACES, result, SKIN, TRANSFORMS)
    own, other = (fit_skin(*given, to_planes=flag, device=device).skin for flag in (None, quality == "best"))
    assert error(own, result, TRANSFORMS) < error(other, result, TRANSFORMS)


def test_skin_follows_the_points_of_the_result_on_request(device):
    result = simplified(quality="fast")
    # At their quadrics' least the vertices are nearer to the planes; where the result has them, nearer to it.
    skins = [fit_skin(POSES, FACES, result, SKIN, TRANSFORMS, to_planes=flag, device=device).skin for flag in (0, 1)]
    away = [np.abs(pose_skin(skin, TRANSFORMS) - result.points).mean() for skin in skins]
    assert away[0] < away[1]
    assert error(skins[1], result, TRANSFORMS) < error(skins[0], result, TRANSFORMS)


def test_skin_is_the_same_on_every_run(result, device):
    runs = [fit_skin(POSES, FACES, result, SKIN, TRANSFORMS, device=device).skin for _ in range(2)]
    for name in ("rest", "joints", "weights"):
        np.testing.assert_array_equal(getattr(runs[0], name), getattr(runs[1], name))


def test_locked_vertices_keep_their_skin(device):
    locked = [5, 100, 300]
    result = simplified(locked=locked)
    skin = fit_skin(POSES, FACES, result, SKIN, TRANSFORMS, device=device).skin
    place = result.vertex_map[locked]
    np.testing.assert_array_equal(skin.rest[place], SKIN.rest[locked])
    order = np.argsort(-SKIN.weights[locked], axis=1, kind="stable")
    np.testing.assert_allclose(skin.weights[place], np.take_along_axis(SKIN.weights[locked], order, 1), atol=1e-6)


def test_offsets_of_blend_shapes_come_before_the_joints(device):
    lift = np.zeros_like(POSES)
    lift[3:7, :, 2] = 0.05 * np.sin(6 * SKIN.rest[:, 0])
    poses = pose_skin(SKIN, TRANSFORMS, lift).astype(np.float32)
    result = warpqem.simplify(poses, FACES, ratio=0.2, device="cpu")
    fitted = fit_skin(poses, FACES, result, SKIN, TRANSFORMS, offsets=lift, device=device)
    assert fitted.after < 0.75 * fitted.before


def test_size_of_the_mesh_does_not_matter(result, device):
    big = 1000.0
    scaled = TRANSFORMS.copy()
    scaled[..., 3] *= big
    large = replace(result, points=result.points * np.float32(big))
    plain = fit_skin(POSES, FACES, result, SKIN, TRANSFORMS, device=device)
    skin = replace(SKIN, rest=SKIN.rest * np.float32(big))
    other = fit_skin(POSES * np.float32(big), FACES, large, skin, scaled, device=device)
    np.testing.assert_allclose(other.skin.rest / big, plain.skin.rest, atol=2e-3)
    assert np.isclose(other.after, plain.after, rtol=0.02)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"transforms": TRANSFORMS[:5]}, MeshShapeError, r"transforms must be \(12, J, 3, 4\)"),
        ({"transforms": TRANSFORMS[:, :2]}, MeshShapeError, "is moved by joint"),
        ({"transforms": TRANSFORMS[::-1]}, MeshShapeError, "pose 0 is not what skin and transforms give"),
        ({"skin": replace(SKIN, rest=SKIN.rest[:9])}, MeshShapeError, "9 rest points"),
        ({"skin": replace(SKIN, joints=SKIN.joints[:, :2])}, MeshShapeError, "a skin needs rest"),
        ({"influences": 0}, OptionError, "influences must be at least 1"),
    ],
)
def test_wrong_arguments_are_named(result, change, error, message):
    arguments = {"points": POSES, "faces": FACES, "result": result, "skin": SKIN, "transforms": TRANSFORMS, **change}
    with pytest.raises(error, match=message):
        fit_skin(**arguments, device="cpu")


def test_largest_influences_of_a_blend_come_first_and_sum_to_one():
    joints = np.array([[0, 1], [1, 2], [3, 3]], dtype=np.int32)
    weights = np.array([[0.5, 0.5], [0.9, 0.1], [1.0, 0.0]])
    blended = blend_influences(joints, weights, np.array([[0, 1, 2]]), np.array([[0.5, 0.5, 0.0]]))
    assert blended[0].tolist() == [[1, 0]]
    np.testing.assert_allclose(blended[1], [[0.70 / 0.95, 0.25 / 0.95]])


def test_rounded_weights_sum_to_one_as_well_as_float32_can():
    weights = np.sort(np.random.default_rng(0).dirichlet(np.ones(4), 500), axis=1)[:, ::-1]
    np.testing.assert_allclose(normalised_weights(weights).sum(axis=1, dtype=np.float64), 1.0, atol=1.2e-7)
    assert not normalised_weights(np.zeros((2, 3))).any()


def test_vertex_with_more_influences_than_may_be_is_fitted_although_it_does_not_move(device):
    # Hardly simplified: nearly every vertex is alone in its cluster, with three influences.
    result = simplified(ratio=0.95)
    skin = fit_skin(POSES, FACES, result, SKIN, TRANSFORMS, influences=1, device=device).skin
    whole = interpolated(result)
    rows = np.arange(len(whole.rest))[:, None]
    cut = LinearSkin(whole.rest, *blend_influences(whole.joints, whole.weights, rows, np.ones(rows.shape), 1))
    assert error(skin, result, TRANSFORMS) < 0.9 * error(cut, result, TRANSFORMS)
