"""Large meshes are ordered along a space-filling curve; nothing of it shows in the result."""

import numpy as np
import pytest
import warp as wp

import warpqem
from tests.support import meshes
from tests.support.mesh_state import blocks, packed
from warpqem.decimation import decimate as stage
from warpqem.decimation.arrangement import arrange
from warpqem.kernels.arrangement import gather_rows
from warpqem.kernels.lanes import width_of

POINTS, FACES = meshes.waving_grid(12, 3)


def shuffled(points, faces):
    """The same mesh with vertices and faces in no order."""
    rng = np.random.default_rng(5)
    order = rng.permutation(points.shape[1])
    place = np.argsort(order).astype(np.int32)
    return points[:, order], rng.permutation(place[faces])


def test_vertices_and_faces_are_permuted():
    points, faces = shuffled(POINTS, FACES)
    arrangement = arrange(faces, points[0])
    np.testing.assert_array_equal(np.sort(arrangement.vertex), np.arange(points.shape[1]))
    np.testing.assert_array_equal(arrangement.vertex[arrangement.place], np.arange(points.shape[1]))
    np.testing.assert_array_equal(arrangement.vertex[arrangement.rearrange_faces(faces)], faces[arrangement.face])


def test_values_of_corners_come_back():
    arrangement = arrange(FACES, POINTS[0])
    values = np.random.default_rng(6).permutation(FACES.size)
    np.testing.assert_array_equal(arrangement.restore_corners(arrangement.rearrange_corners(values)), values)


def test_neighbours_come_close_together():
    points, faces = shuffled(POINTS, FACES)
    arranged = arrange(faces, points[0]).rearrange_faces(faces)
    assert np.abs(np.diff(arranged, axis=1)).mean() < 0.3 * np.abs(np.diff(faces, axis=1)).mean()


def test_arrangement_does_not_depend_on_the_order_of_vertices():
    points, faces = shuffled(POINTS, FACES)
    one, other = arrange(FACES, POINTS[0]), arrange(faces, points[0])
    np.testing.assert_array_equal(POINTS[0][one.vertex], points[0][other.vertex])


def test_mesh_without_extent_keeps_its_order():
    arrangement = arrange(FACES, np.ones_like(POINTS[0]))
    np.testing.assert_array_equal(arrangement.vertex, np.arange(POINTS.shape[1]))


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
    a = arrange(faces, (points[0] - (points.min((0, 1)) + points.max((0, 1))) / 2).astype(np.float32))
    rng = np.random.default_rng(7)
    weights = rng.uniform(0.5, 2, points.shape[1])
    locked = np.zeros(points.shape[1], dtype=bool)
    locked[rng.integers(points.shape[1], size=3)] = True
    field = warpqem.costs.AttributeField
    options = {"ratio": 0.3, "metric": metric, "device": device}
    plain = warpqem.simplify(
        np.ascontiguousarray(points[:, a.vertex]),
        a.rearrange_faces(faces),
        vertex_weights=weights[a.vertex],
        locked=locked[a.vertex],
        attributes=[field(uv[a.face], 0.1)],
        **options,
    )
    monkeypatch.setattr(stage, "ARRANGED_FACES", 0)
    inside = warpqem.simplify(
        points, faces, vertex_weights=weights, locked=locked, attributes=[field(uv, 0.1)], **options
    )
    np.testing.assert_array_equal(inside.log.kept, a.vertex[plain.log.kept])
    np.testing.assert_array_equal(inside.log.removed, a.vertex[plain.log.removed])
    np.testing.assert_array_equal(
        inside.log.opposites, np.where(plain.log.opposites < 0, -1, a.vertex[plain.log.opposites])
    )
    np.testing.assert_array_equal(np.sort(inside.face_map), np.sort(a.face[plain.face_map]))


def test_anchors_and_places_do_not_know_of_the_arrangement(device, every_mesh_arranged):
    points, faces = shuffled(POINTS, FACES)
    result = warpqem.simplify(points, faces, ratio=0.3, device=device)
    assert (np.diff(result.face_map) > 0).all()
    # Every output vertex lies among the input vertices that it stands for.
    for vertex in range(result.points.shape[1]):
        members = points[:, result.vertex_map == vertex]
        distance = np.linalg.norm(result.points[:, None, vertex] - members, axis=2).min(axis=1)
        assert distance.max() < 0.2
