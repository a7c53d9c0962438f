"""Large meshes are ordered along a space-filling curve; nothing of it shows in the result."""

import numpy as np
import pytest
import warp as wp

import warpqem
from tests.support import meshes
from tests.support.mesh_state import blocks, corners_of, packed
from warpqem.decimation import decimate as stage
from warpqem.decimation.arrangement import Arrangement, arrange
from warpqem.kernels.arrangement import gather_rows
from warpqem.kernels.lanes import width_of

POINTS, FACES = meshes.waving_grid(12, 3)


def shuffled(points, faces):
    """The same mesh with vertices and faces in no order."""
    rng = np.random.default_rng(5)
    order = rng.permutation(points.shape[1])
    place = np.argsort(order).astype(np.int32)
    return points[:, order], rng.permutation(place[faces])


def arranged(points, faces, device) -> Arrangement:
    """A mesh arranged by one pose (V, 3)."""
    return arrange(corners_of(faces, device), packed(points[None], device))


def expected_arrangement(points, faces) -> tuple[np.ndarray, np.ndarray]:
    """The vertex and the face at each place, by Morton codes bit by bit."""
    low = points.min(axis=0)
    extent = float((points.max(axis=0) - low).max())
    cell = ((points - low) * np.float32(1023 / extent)).astype(np.int64)
    code = sum((cell[:, axis] >> bit & 1) << (3 * bit + axis) for bit in range(10) for axis in range(3))
    vertex = np.argsort(code, kind="stable")
    return vertex, np.argsort(np.argsort(vertex)[faces].min(axis=1), kind="stable")


@pytest.mark.parametrize("height", [1.0, 0.0])
def test_vertices_and_faces_lie_along_the_curve(height, device):
    points, faces = shuffled(POINTS, FACES)
    pose = points[0] * np.array([1, height, 1], dtype=np.float32)
    arrangement = arranged(pose, faces, device)
    vertex, face = expected_arrangement(pose, faces)
    np.testing.assert_array_equal(arrangement.host_vertex, vertex)
    np.testing.assert_array_equal(arrangement.host_place, np.argsort(vertex))
    np.testing.assert_array_equal(arrangement.host_face, face)


def test_first_of_many_frames_counts(device):
    points, faces = shuffled(POINTS, FACES)
    arrangement = arrange(corners_of(faces, device), packed(points, device))
    np.testing.assert_array_equal(arrangement.host_vertex, arranged(points[0], faces, device).host_vertex)


def test_vertices_and_faces_are_permuted(device):
    points, faces = shuffled(POINTS, FACES)
    arrangement = arranged(points[0], faces, device)
    corner_vertex = arrangement.rearrange_faces(corners_of(faces, device)).numpy()
    vertex, face = arrangement.host_vertex, arrangement.host_face
    np.testing.assert_array_equal(np.sort(vertex), np.arange(points.shape[1]))
    np.testing.assert_array_equal(vertex[arrangement.host_place], np.arange(points.shape[1]))
    np.testing.assert_array_equal(vertex[corner_vertex.reshape(-1, 3)], faces[face])


@pytest.mark.parametrize("dtype", [np.int32, np.float32])
def test_values_are_rearranged(dtype, device):
    points, faces = shuffled(POINTS, FACES)
    arrangement, rng = arranged(points[0], faces, device), np.random.default_rng(6)
    of_vertices, of_corners = (rng.permutation(n).astype(dtype) for n in (points.shape[1], faces.size))
    np.testing.assert_array_equal(
        arrangement.rearrange_vertices(wp.array(of_vertices, device=device)).numpy(),
        of_vertices[arrangement.host_vertex],
    )
    np.testing.assert_array_equal(
        arrangement.rearrange_corners(wp.array(of_corners, device=device)).numpy(),
        of_corners.reshape(-1, 3)[arrangement.host_face].ravel(),
    )


def test_half_edges_come_back(device):
    points, faces = shuffled(POINTS, FACES)
    arrangement = arranged(points[0], faces, device)
    corner_vertex = arrangement.rearrange_faces(corners_of(faces, device)).numpy()
    half_edge = np.random.default_rng(6).integers(faces.size, size=50).astype(np.int32)
    restored = arrangement.restore_half_edges(half_edge)
    np.testing.assert_array_equal(faces.ravel()[restored], arrangement.host_vertex[corner_vertex[half_edge]])
    np.testing.assert_array_equal(restored % 3, half_edge % 3)


def test_neighbours_come_close_together(device):
    points, faces = shuffled(POINTS, FACES)
    near = arranged(points[0], faces, device).rearrange_faces(corners_of(faces, device)).numpy().reshape(-1, 3)
    assert np.abs(np.diff(near, axis=1)).mean() < 0.3 * np.abs(np.diff(faces, axis=1)).mean()


def test_arrangement_does_not_depend_on_the_order_of_vertices(device):
    points, faces = shuffled(POINTS, FACES)
    one, other = arranged(POINTS[0], FACES, device), arranged(points[0], faces, device)
    np.testing.assert_array_equal(POINTS[0][one.host_vertex], points[0][other.host_vertex])


def test_mesh_without_extent_keeps_its_order(device):
    arrangement = arranged(np.ones_like(POINTS[0]), FACES, device)
    np.testing.assert_array_equal(arrangement.host_vertex, np.arange(POINTS.shape[1]))


@pytest.fixture
def every_mesh_arranged(monkeypatch):
    monkeypatch.setattr(stage, "ARRANGED_FACES", 0)


def test_rows_of_positions_are_gathered(device):
    rows = packed(POINTS, device)
    index = np.random.default_rng(6).permutation(POINTS.shape[1]).astype(np.int32)
    out = wp.empty_like(rows)
    inputs = [rows, wp.array(index, device=device)]
    wp.launch(gather_rows[width_of(rows)], dim=rows.shape, inputs=inputs, outputs=[out], device=device)
    np.testing.assert_array_equal(blocks(out, len(POINTS)), blocks(rows, len(POINTS))[index])


@pytest.mark.parametrize("metric", ["dsd", "dod"])
def test_result_is_that_of_the_rearranged_mesh_under_the_input_names(metric, device, monkeypatch):
    points, faces = shuffled(POINTS, FACES)
    # Colours in the order, a locked vertex and a weight each: everything that comes by vertex or by corner.
    uv = points[0][faces][..., :2] * 3
    centred = (points[0] - (points.min((0, 1)) + points.max((0, 1))) / 2).astype(np.float32)
    arrangement = arranged(centred, faces, device)
    vertex, face = arrangement.host_vertex, arrangement.host_face
    rng = np.random.default_rng(7)
    weights = rng.uniform(0.5, 2, points.shape[1])
    locked = np.zeros(points.shape[1], dtype=bool)
    locked[rng.integers(points.shape[1], size=3)] = True
    field = warpqem.costs.AttributeField
    options = {"ratio": 0.3, "metric": metric, "device": device}
    plain = warpqem.simplify(
        np.ascontiguousarray(points[:, vertex]),
        arrangement.rearrange_faces(corners_of(faces, device)).numpy().reshape(-1, 3),
        vertex_weights=weights[vertex],
        locked=locked[vertex],
        attributes=[field(uv[face], 0.1)],
        **options,
    )
    monkeypatch.setattr(stage, "ARRANGED_FACES", 0)
    inside = warpqem.simplify(
        points, faces, vertex_weights=weights, locked=locked, attributes=[field(uv, 0.1)], **options
    )
    np.testing.assert_array_equal(inside.log.kept, vertex[plain.log.kept])
    np.testing.assert_array_equal(inside.log.removed, vertex[plain.log.removed])
    np.testing.assert_array_equal(
        inside.log.opposites, np.where(plain.log.opposites < 0, -1, vertex[plain.log.opposites])
    )
    np.testing.assert_array_equal(np.sort(inside.face_map), np.sort(face[plain.face_map]))


def test_anchors_and_places_do_not_know_of_the_arrangement(device, every_mesh_arranged):
    points, faces = shuffled(POINTS, FACES)
    result = warpqem.simplify(points, faces, ratio=0.3, device=device)
    assert (np.diff(result.face_map) > 0).all()
    # Every output vertex lies among the input vertices that it stands for.
    for vertex in range(result.points.shape[1]):
        members = points[:, result.vertex_map == vertex]
        distance = np.linalg.norm(result.points[:, None, vertex] - members, axis=2).min(axis=1)
        assert distance.max() < 0.2
