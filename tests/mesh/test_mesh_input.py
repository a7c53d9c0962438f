"""What becomes of the caller's points and faces."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from warpqem.mesh.mesh_input import read_mesh
from warpqem.pipeline.key_frames import KeyFrameChoice


@pytest.mark.parametrize("faces", [[[0, 1, 2], [2, 1, 3]], [[0, 1, 2], [2, 2, 3]]], ids=["proper", "not all"])
def test_faces_are_a_copy_of_the_callers(faces):
    given_faces = np.array(faces, dtype=np.int32)
    mesh = read_mesh(np.zeros((5, 3)), given_faces)
    given_faces[:] = 4
    assert mesh.faces[0].tolist() == [0, 1, 2]
    assert mesh.face_index.dtype == np.int32


@given(st.lists(st.tuples(*[st.integers(0, 5)] * 3), min_size=1, max_size=8))
def test_faces_that_use_a_vertex_twice_are_left_out_and_others_mark_their_vertices(rows):
    proper = [row for row in rows if len(set(row)) == 3]
    mesh = read_mesh(np.zeros((6, 3)), [*rows, (0, 1, 2)])
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
