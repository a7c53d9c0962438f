"""Symmetric meshes that stay symmetric."""

import numpy as np
import pytest

import warpqem
from tests.support.meshes import tube
from tests.support.moving_meshes import rms
from tests.support.symmetry import FACES, IMAGE, POINTS
from warpqem.decimation.collapse_log import CollapseRecord
from warpqem.errors import OptionError, UnreachableTargetError
from warpqem.frames.stream import ArraySink
from warpqem.measure import compare
from warpqem.pipeline.mirror import MirrorPlane, find_mirror
from warpqem.pipeline.symmetry import simplify_symmetric


def simplified(**options: object) -> warpqem.SimplifiedMesh:
    return simplify_symmetric(POINTS, FACES, "x", **{"ratio": 0.3, "device": "cpu", **options})


def face_counts(faces: np.ndarray) -> np.ndarray:
    """Faces at each edge."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    return np.unique(edges, axis=0, return_counts=True)[1]


def replayed(log: CollapseRecord, faces: np.ndarray) -> list[int]:
    """Face counts after each collapse, by the log's word and by carrying it out."""
    counts, current = [], faces.copy()
    for kept, removed in zip(log.kept, log.removed, strict=True):
        current = np.where(current == removed, kept, current)
        current = current[(np.roll(current, 1, axis=1) != current).all(axis=1)]
        counts.append(len(current))
    return counts


def test_mirror_is_found_across_the_axis_that_has_one():
    mirror = find_mirror(POINTS[0], FACES)
    np.testing.assert_array_equal(mirror.vertex, IMAGE)
    np.testing.assert_array_equal(np.sort(mirror.face), np.arange(len(FACES)))
    assert len(mirror.half) == len(FACES) // 2


def test_mirror_plane_may_be_given():
    plane = MirrorPlane(np.array([1.0, 0, 0]), 2.0)
    np.testing.assert_array_equal(find_mirror(POINTS[0] + np.float32([2, 0, 0]), FACES, plane).vertex, IMAGE)


@pytest.mark.parametrize("ratio", [0.7, 0.3, 0.1, 0.05])
def test_result_is_symmetric_and_a_manifold(device, ratio):
    result = simplify_symmetric(POINTS, FACES, "x", ratio=ratio, device=device)
    target = round(ratio * len(FACES))
    assert target - 3 <= len(result.faces) <= target
    assert len(find_mirror(result.points[0], result.faces, "x").half) == len(result.faces) // 2
    assert face_counts(result.faces).max() == 2


def test_vertex_map_and_face_map_fit_the_result():
    result = simplified()
    assert (result.vertex_map >= 0).all()
    np.testing.assert_array_equal(np.unique(result.vertex_map), np.arange(result.points.shape[1]))
    # Each output face goes on from an input face whose corners became its own.
    np.testing.assert_array_equal(result.vertex_map[FACES[result.face_map]], result.faces)


def test_mirror_images_lie_in_mirrored_clusters():
    result = simplified()
    image = find_mirror(result.points[0], result.faces, "x").vertex
    np.testing.assert_array_equal(result.vertex_map[IMAGE], image[result.vertex_map])


def test_motion_need_not_be_symmetric(device):
    result = simplified()
    plain = warpqem.simplify(POINTS, FACES, target_faces=len(result.faces), device=device)
    error, plain_error = (rms((POINTS, FACES), item, device) for item in (result, plain))
    assert error < 1.4 * plain_error


def test_log_tells_the_whole_story():
    result = simplified()
    counts = replayed(result.log, FACES)
    assert counts[-1] == len(result.faces)
    np.testing.assert_array_equal(len(FACES) - np.cumsum(result.log.faces_removed), counts)
    root = result.log.roots(POINTS.shape[1])
    pairs = np.unique(np.stack([root, result.vertex_map], axis=1), axis=0)
    # One cluster of the log for each output vertex, and one output vertex for each cluster.
    assert len(pairs) == result.points.shape[1] == len(np.unique(pairs[:, 0]))


def test_lock_of_one_vertex_holds_its_image_too():
    result = simplified(locked=[5])
    for vertex in (5, IMAGE[5]):
        np.testing.assert_allclose(result.points[:, result.vertex_map[vertex]], POINTS[:, vertex], atol=1e-6)


def test_locked_borders_are_those_of_the_whole():
    result = simplified(ratio=0.2, lock_borders=True)
    ends = np.concatenate([np.arange(16), POINTS.shape[1] - 16 + np.arange(16)])
    np.testing.assert_allclose(result.points[:, result.vertex_map[ends]], POINTS[:, ends], atol=1e-6)
    middle = np.flatnonzero(np.arange(len(IMAGE)) == IMAGE)
    # The cut is no border: it loses vertices like the rest.
    assert len(np.unique(result.vertex_map[middle])) < len(middle)


def test_max_error_tells_a_mesh_that_cannot_be_simplified():
    locked = np.ones(POINTS.shape[1], dtype=bool)
    assert simplified(ratio=None, max_error=1000.0, locked=locked).stopped == "no legal collapse"
    with pytest.raises(UnreachableTargetError):
        simplified(ratio=None, max_error=1000.0, target_faces=4, locked=locked)


def test_max_error_holds_for_the_whole():
    result = simplified(ratio=None, max_error=0.3)
    assert compare(POINTS, FACES, result.points, result.faces, samples=4000, device="cpu").hausdorff <= 0.3
    assert len(result.faces) < len(FACES)
    diagonal = np.linalg.norm(np.ptp(POINTS, axis=1), axis=1).max()
    assert np.isclose(result.diagonal, diagonal, rtol=1e-6)


def test_seam_of_one_half_is_one_of_both():
    ring = np.flatnonzero(np.isclose(POINTS[0, :, 0], 0.25, atol=1e-3))
    pairs = np.concatenate([FACES[:, [0, 1]], FACES[:, [1, 2]], FACES[:, [2, 0]]])
    seams = pairs[np.isin(pairs, ring).all(axis=1)]
    result = simplified(ratio=0.4, seams=seams)
    for side in (ring, IMAGE[ring]):
        x = np.abs(result.points[0, np.unique(result.vertex_map[side]), 0])
        np.testing.assert_allclose(x, 0.25, atol=0.02)


def test_sink_gets_the_frames():
    sink = ArraySink()
    result = simplified(sink=sink)
    np.testing.assert_array_equal(sink.points, simplified().points)
    assert result.points.shape[0] == 1


def test_result_is_the_same_on_every_run():
    np.testing.assert_array_equal(simplified().points, simplified().points)


def test_refit_stays_symmetric():
    result = simplified(refit=True)
    assert len(find_mirror(result.points[0], result.faces, "x").half) == len(result.faces) // 2


def test_target_that_cannot_be_reached_is_an_error_with_the_result():
    with pytest.raises(UnreachableTargetError, match="1 were asked for") as caught:
        simplified(ratio=None, target_faces=1)
    assert len(caught.value.result.faces) < 40


def test_mesh_without_symmetry_says_where():
    points = POINTS[0].copy()
    points[7] += 0.05
    with pytest.raises(OptionError, match="symmetry: vertex 7 has no mirror image"):
        find_mirror(points, FACES, "x")
    with pytest.raises(OptionError, match="symmetry: the mesh has no mirror plane: across x vertex 7"):
        find_mirror(points, FACES)


def test_faces_cut_otherwise_on_the_other_side_are_named():
    points, faces = tube(16, 24)
    with pytest.raises(OptionError, match=r"symmetry: face \d+ has no mirror image"):
        find_mirror(points, faces, "x")


def test_face_across_the_plane_is_named():
    points = np.array([[-1, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0]], dtype=np.float32)
    with pytest.raises(OptionError, match="symmetry: face 0 lies across the plane"):
        find_mirror(points, np.array([[0, 1, 2], [1, 0, 3]]), "x")


def test_unknown_axis_is_refused():
    with pytest.raises(OptionError, match="symmetry 'w': expected auto, x, y, z"):
        find_mirror(POINTS[0], FACES, "w")
