"""Which edges are hard, and looks of several meshes as one."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support import meshes
from warpqem.picture.look import Look, Part, Texture, corner_normals, joined, plain_look, smoothing_groups

# A box of two faces a side, its corners shared.
BOX = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float64)
QUADS = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
BOX_FACES = np.concatenate([QUADS[:, [0, 1, 2]], QUADS[:, [0, 2, 3]]])


def test_edges_of_a_box_are_hard_and_its_diagonals_are_not():
    groups = smoothing_groups(BOX, BOX_FACES)
    assert groups.max() + 1 == 24
    normals = corner_normals(BOX, BOX_FACES, groups)
    assert np.sort(np.abs(normals), axis=2) == pytest.approx(np.broadcast_to([0, 0, 1], normals.shape))


def test_round_meshes_are_smooth_all_over():
    points, faces = meshes.icosphere(2)
    groups = smoothing_groups(points, faces)
    assert groups.max() + 1 == len(points)
    normals = corner_normals(points, faces, groups)
    unit = points[faces] / np.linalg.norm(points[faces], axis=2, keepdims=True)
    assert (normals * unit).sum(axis=2).min() > 0.999


def test_authored_normals_decide_where_there_are_some():
    points, faces = meshes.icosphere(1)
    smooth = np.broadcast_to([0.0, 0.0, 1.0], (len(BOX_FACES), 3, 3))
    assert smoothing_groups(BOX, BOX_FACES, smooth).max() + 1 == len(BOX)
    corner = points[faces]
    flat = np.repeat(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])[:, None], 3, axis=1)
    assert smoothing_groups(points, faces, flat).max() + 1 == 3 * len(faces)
    none = np.full((len(BOX_FACES), 3, 3), np.nan)
    np.testing.assert_array_equal(smoothing_groups(BOX, BOX_FACES, none), smoothing_groups(BOX, BOX_FACES))


def test_seams_of_doubled_points_do_not_show():
    points, faces = meshes.icosphere(2)
    split = points[faces].reshape(-1, 3)
    own = np.arange(len(split)).reshape(-1, 3)
    assert smoothing_groups(split, own).max() + 1 == len(points)


@pytest.mark.parametrize("turn", [1, 2])
def test_winding_of_a_neighbour_does_not_matter_to_the_link(turn):
    # A sheet of two faces, the second from each of its corners.
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float64)
    faces = np.array([[0, 1, 2], np.roll([0, 2, 3], turn)])
    assert smoothing_groups(points, faces).max() + 1 == 4


def test_mesh_without_faces_has_no_groups():
    assert smoothing_groups(np.zeros((3, 3)), np.zeros((0, 3), dtype=int)).shape == (0, 3)


def test_joined_looks_keep_their_faces_and_share_textures():
    texture = Texture(np.zeros((2, 2, 3), dtype=np.uint8))
    uvs = np.full((2, 3, 2), 0.5)
    one = Look(np.array([1, 0]), [Part("a"), Part("b", 0)], [texture], uvs=uvs)
    other = Look(np.zeros(1, dtype=int), [Part("c", 0)], [texture], colors=np.ones((1, 3, 3)))
    both = joined([one, other, plain_look(1, "d")])
    assert both.face_part.tolist() == [1, 0, 2, 3]
    assert [(part.name, part.texture) for part in both.parts] == [("a", None), ("b", 0), ("c", 0), ("d", None)]
    assert both.textures == [texture]
    assert both.uvs.shape == (4, 3, 2)
    assert both.uvs[:2] == pytest.approx(uvs)
    assert both.colors[2] == pytest.approx(np.ones((3, 3)))
    assert both.normals is None
    assert not both.is_plain
    assert plain_look(1).is_plain
