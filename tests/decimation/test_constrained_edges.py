"""Half-edges of borders and seams, listed from marks on the device."""

import numpy as np
import pytest
import warp as wp

from tests.support import meshes
from tests.support.mesh_state import corners_of, listed_edges
from warpqem.decimation.constrained_edges import ConstrainedEdges


def edges_of(faces, border, seam, device) -> ConstrainedEdges:
    marks = (wp.array(values, dtype=wp.int32, device=device) for values in (border, seam))
    return listed_edges(corners_of(faces, device), *marks)


@pytest.mark.parametrize("share", [0.0, 0.1, 1.0])
def test_marked_half_edges_are_listed_in_order(share, device):
    faces, rng = meshes.grid(5, 4)[1], np.random.default_rng(2)
    border, seam = ((rng.uniform(size=faces.size) < share).astype(np.int32) for _ in range(2))
    seam[border != 0] = 0
    edges = edges_of(faces, border, seam, device)
    listed = np.flatnonzero(border | seam)
    np.testing.assert_array_equal(edges.half_edge, listed)
    np.testing.assert_array_equal(edges.kind, np.where(border, 1, 2)[listed])
    ends = np.stack([faces.ravel(), np.roll(faces, -1, axis=1).ravel()], axis=1)
    np.testing.assert_array_equal(edges.ends, ends[listed])
    np.testing.assert_array_equal(edges.marks(faces.size), border | 2 * seam)
    np.testing.assert_array_equal(edges.of_kind(2).half_edge, np.flatnonzero(seam))


def test_lists_name_each_border_edge_at_both_ends(device):
    faces = meshes.grid(2, 1)[1]
    directed = {(f[k], f[(k + 1) % 3]) for f in faces.tolist() for k in range(3)}
    tail, head = faces.ravel().tolist(), np.roll(faces, -1, axis=1).ravel().tolist()
    border = np.array([(b, a) not in directed for a, b in zip(tail, head, strict=True)], dtype=int)
    vertex, start, half_edge = edges_of(faces, border, 0 * border, device).lists()
    rows = {int(v): half_edge[a:b].tolist() for v, a, b in zip(vertex, start[:-1], start[1:], strict=True)}
    expected = {v: [h for h in np.flatnonzero(border) if v in (tail[h], head[h])] for v in range(6)}
    assert rows == expected


def test_lists_of_a_closed_mesh_are_empty(device):
    faces = meshes.octahedron()[1]
    vertex, start, half_edge = edges_of(faces, np.zeros(faces.size), np.zeros(faces.size), device).lists()
    assert len(vertex) == len(half_edge) == 0
    assert start.tolist() == [0]


def test_edges_are_renumbered(device):
    faces = meshes.grid(2, 1)[1]
    border = np.zeros(faces.size, dtype=np.int32)
    border[[1, 4]] = 1
    edges = edges_of(faces, border, 0 * border, device)
    vertex = np.arange(6, dtype=np.int32)[::-1]
    moved = edges.renumbered(np.array([7, 2]), vertex)
    np.testing.assert_array_equal(np.flatnonzero(moved.marks(faces.size)), [2, 7])
    np.testing.assert_array_equal(moved.ends, vertex[edges.ends])
