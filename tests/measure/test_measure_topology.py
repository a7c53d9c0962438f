"""Validity figures of known meshes."""

import numpy as np
import pytest
import trimesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from warpqem.errors import DegenerateMeshError
from warpqem.measure import topology

TETRAHEDRON = np.array([[0, 1, 2], [0, 3, 1], [1, 3, 2], [0, 2, 3]])


def test_torus_is_closed_manifold_with_euler_number_zero():
    result = topology(np.asarray(trimesh.creation.torus(1, 0.3).faces))
    assert result.euler_number == 0
    assert result.components == 1
    assert result.border_edges == result.non_manifold_edges == result.non_manifold_vertices == 0


def test_tetrahedron_counts():
    result = topology(TETRAHEDRON)
    assert (result.faces, result.vertices, result.edges, result.euler_number) == (4, 4, 6, 2)


def test_two_tetrahedra_sharing_a_vertex_have_one_non_manifold_vertex():
    other = np.array([0, 4, 5, 6])[TETRAHEDRON]
    result = topology(np.concatenate([TETRAHEDRON, other]))
    assert result.non_manifold_vertices == 1
    assert result.non_manifold_edges == 0
    assert result.components == 1


def test_two_tetrahedra_sharing_an_edge_have_one_non_manifold_edge():
    other = np.array([0, 1, 4, 5])[TETRAHEDRON]
    result = topology(np.concatenate([TETRAHEDRON, other]))
    assert result.non_manifold_edges == 1
    assert result.non_manifold_vertices == 0
    assert result.components == 1


def test_separate_tetrahedra_are_two_components():
    assert topology(np.concatenate([TETRAHEDRON, TETRAHEDRON + 10])).components == 2


def test_open_strip_has_border_edges():
    assert topology(np.array([[0, 1, 2], [2, 1, 3]])).border_edges == 4


def test_repeated_and_collapsed_faces_are_counted():
    result = topology(np.array([[0, 1, 2], [2, 0, 1], [1, 1, 3]]))
    assert result.repeated_faces == 1
    assert result.collapsed_faces == 1


def test_unused_vertices_do_not_count():
    assert topology(TETRAHEDRON + 5).vertices == 4


@pytest.mark.parametrize("faces", [60, 200])
def test_components_of_random_faces_match_a_graph_search(faces):
    random = np.random.default_rng(faces).integers(0, 300, (faces, 3))
    graph = coo_matrix((np.ones(2 * faces), (random[:, [0, 1]].ravel(), random[:, [1, 2]].ravel())), shape=(300, 300))
    label = connected_components(graph, directed=False)[1]
    assert topology(random).components == len(np.unique(label[np.unique(random)]))


def test_components_of_a_long_shuffled_strip():
    n = 5000
    strip = np.stack([np.arange(n), np.arange(n) + 1, np.arange(n) + 2], axis=1)
    assert topology(np.random.default_rng(0).permutation(n + 2)[strip]).components == 1


def test_no_face_is_refused():
    with pytest.raises(DegenerateMeshError, match="no face"):
        topology(np.zeros((0, 3), int))
