"""What becomes of the caller's points and faces."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from warpqem.errors import FaceIndexError
from warpqem.mesh.mesh_input import read_mesh
from warpqem.pipeline.key_frames import KeyFrameChoice

WAYS = pytest.mark.parametrize("way", [None, "device"], ids=["host", "device"])


@WAYS
@pytest.mark.parametrize("faces", [[[0, 1, 2], [2, 1, 3]], [[0, 1, 2], [2, 2, 3]]], ids=["proper", "not all"])
def test_faces_are_a_copy_of_the_callers(faces, way, device):
    given_faces = np.array(faces, dtype=np.int32)
    mesh = read_mesh(np.zeros((5, 3)), given_faces, device=way and device)
    given_faces[:] = 4
    assert mesh.faces[0].tolist() == [0, 1, 2]
    assert mesh.face_index.dtype == np.int32


@pytest.mark.parametrize("vertex", [-1, 5, 2**31 - 1])
@pytest.mark.parametrize("corner", [0, 1, 2])
@WAYS
def test_a_vertex_that_is_none_is_refused(vertex, corner, way, device):
    faces = np.array([[0, 1, 2], [2, 1, 3], [4, 3, 2]], dtype=np.int32)
    faces[1, corner] = vertex
    with pytest.raises(FaceIndexError, match=f"face 1 corner {corner} refers to vertex {vertex}"):
        read_mesh(np.zeros((5, 3)), faces, device=way and device)


@pytest.mark.parametrize("dtype", [np.int32, np.int64, np.uint16])
@pytest.mark.parametrize("order", ["C", "F"])
def test_faces_of_any_kind_are_read_alike_on_the_device(dtype, order, device):
    rng = np.random.default_rng(2)
    faces = np.argsort(rng.random((50, 40)), axis=1)[:, :3]
    given_faces = np.asarray(faces, dtype=dtype, order=order)
    points = np.zeros((45, 3))
    there, here = (read_mesh(points, given_faces, device=way) for way in (device, None))
    for mesh in (there, here):
        np.testing.assert_array_equal(mesh.faces, faces)
        np.testing.assert_array_equal(mesh.face_index, np.arange(50))
        np.testing.assert_array_equal(mesh.used, np.isin(np.arange(45), faces))
        assert mesh.faces.dtype == mesh.face_index.dtype == np.int32
        assert mesh.faces.flags.c_contiguous


@WAYS
@given(rows=st.lists(st.tuples(*[st.integers(0, 5)] * 3), min_size=1, max_size=8))
def test_faces_that_use_a_vertex_twice_are_left_out_and_others_mark_their_vertices(way, rows):
    proper = [row for row in rows if len(set(row)) == 3]
    mesh = read_mesh(np.zeros((6, 3)), np.array([*rows, (0, 1, 2)], dtype=np.int32), device=way and "cpu")
    assert mesh.faces.tolist() == [list(row) for row in [*proper, (0, 1, 2)]]
    assert mesh.face_index.tolist() == [i for i, row in enumerate([*rows, (0, 1, 2)]) if len(set(row)) == 3]
    assert np.flatnonzero(mesh.used).tolist() == sorted({v for row in [*proper, (0, 1, 2)] for v in row})


@pytest.mark.parametrize("size", [1, 2, 7])
def test_poses_to_choose_key_frames_from_do_not_depend_on_the_blocks_that_frames_come_in(size):
    points = np.random.default_rng(0).normal(size=(20, 3000, 3)).astype(np.float32) + 100
    faces = np.arange(3000).reshape(-1, 3)
    whole, blocks = (KeyFrameChoice(read_mesh(points, faces), 4) for _ in range(2))
    before = points.copy()
    whole.observe(slice(0, 20), points)
    for first in range(0, 20, size):
        frames = slice(first, min(first + size, 20))
        blocks.observe(frames, points[frames])
    np.testing.assert_array_equal(points, before)
    np.testing.assert_array_equal(whole._poses, blocks._poses)
    own = points[:, whole._vertex]
    np.testing.assert_array_equal(whole._poses, own - own.mean(axis=1, keepdims=True))
