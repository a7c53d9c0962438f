"""Faces of an input that are larger than those of a simplified mesh, listed on the host and on a device."""

import os

import numpy as np
import pytest
import warp as wp

import warpqem
from tests.support import meshes
from warpqem.frames.blocks import pack_frames
from warpqem.measure import large_faces as module
from warpqem.measure.face_lists import FacesAround
from warpqem.measure.large_faces import LargeFaces, large_faces

FINE, FINE_FACES = meshes.grid(9, 9)
# Some faces of the input are as long as the whole simplified mesh.
FINE = FINE.copy()
FINE[:30, 1] *= 8.0
FINE[50] += 5.0
COARSE, COARSE_FACES = meshes.grid(4, 4)
CLUSTER = np.random.default_rng(0).integers(0, len(COARSE), len(FINE)).astype(np.int32)


def arguments(device):
    reference, test = (pack_frames(points[None].astype(np.float32), device) for points in (FINE, COARSE))
    return reference, FacesAround(FINE_FACES, len(FINE)), test, COARSE_FACES


@pytest.mark.parametrize("room", [None, 3, len(FINE_FACES)])
def test_large_faces_are_listed_on_the_device_as_far_as_there_is_room(room, device):
    expected = large_faces(*arguments(device), device)
    assert 3 < len(expected) < len(FINE_FACES) / 2
    listed = LargeFaces(*arguments(device), CLUSTER, device, room)
    rows, corners, clusters = (array.numpy() for array in (listed.rows, listed.corners, listed.clusters))
    there = expected[: listed.room]
    assert rows[0] == len(expected)
    np.testing.assert_array_equal(rows[1 : 1 + len(there)], there)
    np.testing.assert_array_equal(corners[: len(there)], FINE_FACES[there])
    np.testing.assert_array_equal(clusters[: len(there)], CLUSTER[FINE_FACES[there]])
    assert (clusters[len(there) :] == -1).all()


def test_points_of_rows_without_a_face_are_left_out(device):
    listed = LargeFaces(*arguments(device), CLUSTER, device)
    count = int(listed.rows.numpy()[0])
    within = wp.full(4 * listed.room, 0.5, dtype=wp.float32, device=device)
    listed.leave_out_others(within, 4)
    np.testing.assert_array_equal(within.numpy() > 0, np.arange(4 * listed.room) < 4 * count)


def test_points_begin_at_the_corner_that_is_theirs(device):
    listed = LargeFaces(*arguments(device), CLUSTER, device)
    row = np.random.default_rng(1).permutation(len(FINE)).astype(np.int32)
    found = listed.rows_of_corners(row, np.array([2, 0])).numpy()
    faces = listed.rows.numpy()[1 : 1 + listed.rows.numpy()[0]]
    np.testing.assert_array_equal(found[: len(faces)], row[FINE_FACES[faces][:, [2, 0]]])


@pytest.mark.skipif("CUDA_SEMANTICS" not in os.environ, reason="needs CUDA_SEMANTICS")
def test_results_are_the_same_where_there_is_no_room(monkeypatch):
    # Two sheets, and a strip of long faces between them.
    points, faces = meshes.waving_grid(30, 3)
    points = points + np.where(points[0, :, 1] > points[0, :, 1].mean(), 2.0, 0.0)[:, None] * np.array([0, 1, 0])
    options = {"ratio": 0.4, "quality": "best", "device": "cpu", "measure": False}
    expected = warpqem.simplify(points, faces, **options)
    found = []
    monkeypatch.setattr(module, "ROOM", 1)
    monkeypatch.setattr(module, "FACES_PER_ROOM", len(faces))
    make = LargeFaces.__init__

    def noted(self, *args):
        make(self, *args)
        found.append((int(self.rows.numpy()[0]), self.room))

    monkeypatch.setattr(LargeFaces, "__init__", noted)
    again = warpqem.simplify(points, faces, **options)
    assert any(count > room for count, room in found)
    assert again.points.tobytes() == expected.points.tobytes()
    np.testing.assert_array_equal(again.faces, expected.faces)
