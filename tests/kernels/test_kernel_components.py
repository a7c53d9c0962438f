"""Connected components on the device, against those of a graph on the host."""

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support import meshes
from tests.support.mesh_state import corners_of
from warpqem.decimation.adjacency import build_adjacency
from warpqem.decimation.component_forest import ComponentForest
from warpqem.mesh.components import lowest_members

FACES = st.lists(st.lists(st.integers(0, 19), min_size=3, max_size=3, unique=True), min_size=1, max_size=12)


def forest_of(faces, vertex_count, device) -> tuple[ComponentForest, int]:
    """Components, and how many of them have a face."""
    corner_vertex, count = corners_of(faces, device), wp.zeros(1, dtype=wp.int32, device=device)
    forest = ComponentForest(corner_vertex, build_adjacency(corner_vertex, vertex_count).lists, count)
    return forest, int(count.numpy()[0])


def expected_lowest(faces, vertex_count) -> np.ndarray:
    faces = np.asarray(faces)
    return lowest_members(vertex_count, np.concatenate([faces[:, :2], faces[:, 1:]]))


@settings(max_examples=60)
@given(faces=FACES)
def test_components_of_random_faces_are_those_of_their_graph(device, faces):
    (forest, count), lowest = forest_of(faces, 20, device), expected_lowest(faces, 20)
    np.testing.assert_array_equal(forest.lowest.numpy(), lowest)
    np.testing.assert_array_equal(forest.number().numpy(), np.unique(lowest, return_inverse=True)[1])
    assert count == len(np.unique(lowest[np.ravel(faces)]))


def test_long_shuffled_strip_is_one_component(device):
    points, faces = meshes.grid(1, 3000)
    rng = np.random.default_rng(3)
    faces = rng.permutation(rng.permutation(len(points))[faces])
    forest, count = forest_of(faces, len(points), device)
    assert count == 1
    assert (forest.lowest.numpy() == 0).all()


@pytest.mark.parametrize("unused", [0, 3])
def test_vertices_without_a_face_are_no_component_that_counts(unused, device):
    points, faces = meshes.joined(meshes.tetrahedron(), meshes.octahedron())
    forest, count = forest_of(faces + unused, len(points) + unused, device)
    assert count == 2
    assert forest.number().numpy()[-1] == 1 + unused
