"""Seams: polylines of edges that stay on the surface's places where values jump."""

import numpy as np
import pytest

import warpqem
from tests.support import meshes
from warpqem.errors import MeshShapeError, OptionError
from warpqem.mesh.components import lowest_members
from warpqem.mesh.seams import read_seams
from warpqem.pipeline.surface_transfer import joined_faces

POINTS, FACES = meshes.waving_grid(16, 4)
COLUMN = np.array([[17 * row + 8, 17 * (row + 1) + 8] for row in range(16)])


def ringed_tube():
    """A bulging tube whose middle ring of 24 edges is a closed seam."""
    points, faces = meshes.tube(24, 16)
    points = points * (1 + 0.8 * np.sin(np.pi * points[:, :1]) * np.array([0, 1, 1])).astype(np.float32)
    ring = 24 * 8 + np.arange(24)
    return points, faces, np.stack([ring, np.roll(ring, -1)], axis=1)


def edges_of(faces):
    return {tuple(sorted((int(f[k]), int(f[(k + 1) % 3])))) for f in faces for k in range(3)}


def mapped_seam(result, seams):
    """Output edges that the seam's edges became; collapsed ones are left out."""
    ends = result.vertex_map[seams]
    return {tuple(sorted(e)) for e in ends.tolist() if e[0] != e[1]}


@pytest.mark.parametrize("metric", ["qem", "dsd", "dod", "aqem"])
def test_seam_stays_a_chain_of_output_edges(metric, device):
    result = warpqem.simplify(POINTS, FACES, ratio=0.15, seams=COLUMN, metric=metric, device=device)
    assert mapped_seam(result, COLUMN) <= edges_of(result.faces)


def test_ends_of_a_seam_at_the_border_stay_there(device):
    result = warpqem.simplify(POINTS, FACES, ratio=0.15, seams=COLUMN, device=device)
    ends = COLUMN[[0, -1], [0, 1]]
    # A quarter of the distance between two vertices of the input.
    np.testing.assert_allclose(result.points[:, result.vertex_map[ends]], POINTS[:, ends], atol=1 / 64)


def test_cut_that_ends_inside_keeps_its_length(device):
    cut = COLUMN[4:12]
    result = warpqem.simplify(POINTS, FACES, ratio=0.15, seams=cut, quality="fast", device=device)
    ends = cut[[0, -1], [0, 1]]
    np.testing.assert_allclose(result.points[:, result.vertex_map[ends]], POINTS[:, ends], atol=1 / 64)


def quad_borders(size):
    """All edges of a grid of 16 x 16 quads on lines a multiple of ``size`` quads from the first."""
    index = np.arange(17 * 17).reshape(17, 17)
    rows = [np.stack([row[:-1], row[1:]], axis=1) for row in index[::size]]
    columns = [np.stack([column[:-1], column[1:]], axis=1) for column in index.T[::size]]
    return np.concatenate(rows + columns)


def island_count(seams, face_map):
    return len(np.unique(lowest_members(len(FACES), np.stack(joined_faces(FACES, seams), axis=1))[face_map]))


def test_islands_hold_while_there_are_faces_for_them(device):
    seams = quad_borders(4)
    result = warpqem.simplify(POINTS, FACES, target_faces=100, seams=seams, device=device)
    assert result.stopped == "target"
    assert island_count(seams, result.face_map) == 16


def test_islands_give_way_to_the_target(device):
    seams = quad_borders(2)
    result = warpqem.simplify(POINTS, FACES, target_faces=40, seams=seams, device=device)
    assert 39 <= len(result.faces) <= 40
    assert 20 <= island_count(seams, result.face_map) < 64


def test_seam_keeps_its_place(device):
    result = warpqem.simplify(POINTS, FACES, ratio=0.15, seams=COLUMN, device=device)
    x = result.points[:, np.unique(result.vertex_map[COLUMN]), 0]
    np.testing.assert_allclose(x, 0.5, atol=0.03)


def test_seam_keeps_faces_of_both_sides_apart(device):
    result = warpqem.simplify(POINTS, FACES, ratio=0.15, seams=COLUMN, device=device)
    left = (POINTS[0][FACES].mean(axis=1)[:, 0] < 0.5)[result.face_map]
    centre = result.points[0][result.faces].mean(axis=1)[:, 0]
    np.testing.assert_array_equal(centre < 0.5, left)


def test_closed_seam_stays_closed(device):
    points, faces, seams = ringed_tube()
    result = warpqem.simplify(points, faces, ratio=0.1, seams=seams, device=device)
    chain = mapped_seam(result, seams)
    assert chain <= edges_of(result.faces)
    assert 3 <= len(chain) < len(seams)
    assert set(np.bincount(np.array(sorted(chain)).ravel()).tolist()) == {0, 2}


def test_no_seam_changes_nothing(device):
    plain = warpqem.simplify(POINTS, FACES, ratio=0.2, device=device)
    empty = warpqem.simplify(POINTS, FACES, ratio=0.2, seams=np.zeros((0, 2), int), device=device)
    np.testing.assert_array_equal(plain.points, empty.points)


def test_border_edges_are_no_seams():
    seams = read_seams(np.array([[0, 1], [1, 2]]), FACES, POINTS.shape[1])
    assert not seams.half_edge.any()
    assert not seams.on_seam.any()


def test_corners_are_where_a_seam_ends_forks_or_meets_a_border():
    fork = np.concatenate([COLUMN[:5], [[17 * 3 + 8, 17 * 3 + 9]]])
    seams = read_seams(fork, FACES, POINTS.shape[1])
    assert np.flatnonzero(seams.corner).tolist() == [8, 17 * 3 + 8, 17 * 3 + 9, 17 * 5 + 8]


def test_both_half_edges_of_a_seam_edge_are_marked():
    seams = read_seams(COLUMN[3:4, ::-1], FACES, POINTS.shape[1])
    tail, head = FACES.ravel(), np.roll(FACES, -1, axis=1).ravel()
    marked = np.flatnonzero(seams.half_edge)
    assert sorted(zip(tail[marked].tolist(), head[marked].tolist(), strict=True)) == sorted(
        [tuple(COLUMN[3].tolist()), tuple(COLUMN[3, ::-1].tolist())]
    )


def test_pair_without_an_edge_is_named():
    with pytest.raises(OptionError, match="no edge between vertices 0 and 40"):
        read_seams(np.array([[40, 0]]), FACES, POINTS.shape[1])


# The last pair is so far out of range that it would be taken for the edge 17 18 by a key of both vertices.
@pytest.mark.parametrize(("pair", "vertex"), [([-1, 5], -1), ([5, 10**6], 10**6), ([16, 289 + 18], 307)])
def test_vertex_of_a_seam_out_of_range_is_named(pair, vertex):
    assert POINTS.shape[1] == 289
    with pytest.raises(OptionError, match=rf"vert\w+ .*{vertex}"):
        read_seams(np.array([pair]), FACES, POINTS.shape[1])


@pytest.mark.parametrize("seams", [np.zeros((2, 3), int), np.zeros((2, 2)), np.zeros(2, int)])
def test_seams_of_another_shape_or_dtype_are_refused(seams):
    with pytest.raises(MeshShapeError, match=r"seams must be \(S, 2\)"):
        read_seams(seams, FACES, POINTS.shape[1])


def test_face_map_names_the_input_face_each_output_face_was(device):
    faces = np.insert(FACES, 3, [[0, 0, 1]], axis=0)
    result = warpqem.simplify(POINTS, faces, ratio=0.3, device=device)
    was = result.vertex_map[faces[result.face_map]]
    np.testing.assert_array_equal(was, result.faces)
