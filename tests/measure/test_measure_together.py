"""Small meshes that are measured together have the figures that each has alone, to the bit."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from tests.support import meshes
from warpqem.errors import DegenerateMeshError
from warpqem.measure.cells import Cells, Joined
from warpqem.measure.collapsed import collapsed_frames
from warpqem.measure.measured import Measured, StillPair, measure_frames, measure_together, measured_errors

LINE = np.array([[[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]], dtype=np.float32)
ONE_FACE = np.array([[0, 1, 2]], dtype=np.int32)


class Frames:
    """Frames in memory."""

    def __init__(self, points: np.ndarray) -> None:
        self._points = points

    def read(self, frames: slice) -> np.ndarray:
        return self._points[frames]


def pair(one, other) -> StillPair:
    (points, faces), (others, other_faces) = one, other
    return StillPair(np.float32(points)[None], np.int32(faces), np.float32(others)[None], np.int32(other_faces), 0)


def ball(subdivisions: int, scale=(1.0, 1.0, 1.0)):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    return mesh.vertices * scale, mesh.faces


def two_sided(points, faces):
    """The same with the back of each face."""
    return points, np.concatenate([faces, faces[:, ::-1]])


@pytest.fixture
def pairs() -> list[StillPair]:
    sheet, coarse = meshes.grid(9, 9), meshes.grid(4, 4)
    box = trimesh.creation.box((3, 1, 0.2))
    turned = box.faces[:, ::-1]
    unused = (np.concatenate([[[9.0, 9, 9]], ball(1)[0]]), ball(1)[1] + 1)
    return [
        pair(ball(2), ball(1)),
        pair(sheet, coarse),
        pair(two_sided(*sheet), two_sided(*coarse)),
        pair(two_sided(*sheet), coarse),
        pair((box.vertices, box.faces), (box.vertices, turned)),
        pair(ball(2, (1.0, 0.01, 30.0)), unused),
        pair(meshes.grid(2, 2), ball(2)),
    ]


def alone(one: StillPair) -> Measured:
    sides = (Frames(one.reference), one.reference_faces, Frames(one.test), one.test_faces)
    return measured_errors(measure_frames(*sides, [one.frame], device="cpu", overall=True))


def test_meshes_together_have_the_errors_of_each_alone(pairs):
    assert measure_together(pairs, device="cpu") == [alone(one) for one in pairs]


def test_errors_do_not_depend_on_the_order_of_the_meshes(pairs):
    backwards = measure_together(pairs[::-1], device="cpu")
    assert backwards[::-1] == measure_together(pairs, device="cpu")


def test_patches_that_a_search_gives_up_are_searched_further_within_their_mesh(pairs, monkeypatch):
    monkeypatch.setattr("warpqem.measure.patches._is_given_up", lambda found, known: found.high > 0)
    assert measure_together(pairs, device="cpu") == [alone(one) for one in pairs]


def test_collapsed_mesh_has_its_error_and_the_others_have_theirs(pairs):
    line = StillPair(LINE, ONE_FACE, LINE, ONE_FACE, 0)
    found = measure_together([pairs[0], line, pairs[1]], device="cpu")
    assert isinstance(found[1], DegenerateMeshError)
    assert "collapsed to a point or a line" in str(found[1])
    assert [found[0], found[2]] == [alone(pairs[0]), alone(pairs[1])]


def test_mesh_beyond_all_searches_has_its_error_wherever_it_stands(pairs):
    corners = np.float32([[[0, 0, 0], [1e15, 0, 0], [0, 1e15, 0]]])
    far = StillPair(np.eye(3, dtype=np.float32)[None], ONE_FACE, corners, ONE_FACE, 0)
    for place in range(3):
        given = [pairs[0], pairs[1]]
        given.insert(place, far)
        found = measure_together(given, device="cpu")
        assert "every face is degenerate in frame 0" in str(found.pop(place))
        assert found == [alone(pairs[0]), alone(pairs[1])]


@pytest.mark.parametrize("bend", [0.0, 1e-9, 1e-3])
def test_one_of_several_meshes_that_is_a_line_is_found(bend):
    line = LINE[0].astype(np.float64)
    line[1, 1] = bend
    points, faces = ball(1)
    joined = Joined.of([faces, ONE_FACE], [len(points), 3])
    both = np.concatenate([points, line])[None]
    assert collapsed_frames(both, joined.faces, joined.first_face).tolist() == [bend < 1e-6]


def test_meshes_are_cells_one_after_another():
    points, faces = ball(1)
    cells = Cells(Joined.of([ONE_FACE, faces], [5, len(points)]), 1, "test", "cpu")
    assert cells.first_face.tolist() == [0, 1, 81]
    # Two of the five vertices are of no face.
    assert cells.first_point.tolist() == [0, 3, 45]
    assert np.array_equal(np.unique(cells.mesh_of_face, return_counts=True)[1], [1, 80])
