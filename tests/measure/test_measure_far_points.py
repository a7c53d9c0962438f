"""Vertices far from the faces around, in many frames at once, against the closest points of trimesh."""

import numpy as np
import pytest
import trimesh

from tests.support import meshes
from warpqem.measure.far_points import FacesAround, far_points, longest_edges
from warpqem.measure.unit_frames import ChangingBlock, UnitBlock, UnitFrames

FACES = meshes.grid(6, 6)[1]
VERTEX_COUNT = 49


def blocks(rng, frame_count, device):
    """Points (F, V, 3) around a wavy grid, that grid, and both as blocks."""
    other = np.repeat(meshes.grid(6, 6)[0][None], frame_count, axis=0).astype(np.float32)
    other += rng.normal(scale=0.02, size=other.shape).astype(np.float32)
    own = other + rng.normal(scale=0.05, size=other.shape).astype(np.float32)
    units = UnitFrames(np.zeros((frame_count, 3)), np.ones(frame_count))
    return own, other, UnitBlock(own, units, device), UnitBlock(other, units, device)


def distances(own, other, faces):
    """The distance (F,) of points (F, 3) from some faces."""
    found = []
    for point, points in zip(own, other, strict=True):
        triangles = points[faces].astype(np.float64)
        closest = trimesh.triangles.closest_point(triangles, np.repeat(point[None], len(faces), axis=0))
        found.append(np.linalg.norm(closest - point, axis=1).min())
    return np.array(found)


def second_ring(vertex):
    ring = FACES[(vertex == FACES).any(axis=1)]
    return FACES[np.isin(FACES, ring).any(axis=1)]


@pytest.mark.parametrize("frame_count", [1, 3, 21])
def test_a_vertex_is_far_where_it_is_beyond_the_limit_of_two_rings_in_a_frame(frame_count, device):
    own, other, reference, test = blocks(np.random.default_rng(frame_count), frame_count, device)
    vertex = np.arange(VERTEX_COUNT)
    largest = np.array([distances(own[:, v], other, second_ring(v)).max() for v in vertex])
    limit = float(np.median(largest))
    far = far_points(reference, test, FacesAround(FACES, VERTEX_COUNT), vertex, vertex, limit, device)
    clear = np.abs(largest - limit) > 1e-5
    assert np.array_equal(np.isin(vertex, far)[clear], (largest > limit)[clear])


def test_faces_around_a_vertex_are_those_with_a_corner_there():
    around = FacesAround(FACES, VERTEX_COUNT)
    face, row = around.of(np.array([7, 48, 0]))
    for index, vertex in enumerate((7, 48, 0)):
        assert set(face[row == index]) == set(np.flatnonzero((vertex == FACES).any(axis=1)))


def test_a_second_ring_has_each_face_once():
    start, face = FacesAround(FACES, VERTEX_COUNT).second_ring(np.array([24, 3]))
    for index, vertex in enumerate((24, 3)):
        found = face[start[index] : start[index + 1]]
        assert len(set(found)) == len(found)
        assert np.array_equal(np.sort(FACES[found], axis=0), np.sort(second_ring(vertex), axis=0))


@pytest.mark.parametrize("frame_count", [1, 3, 21])
def test_vertices_put_in_place_some_at_a_time_are_those_put_there_at_once(frame_count, device):
    rng = np.random.default_rng(5)
    points = rng.normal(size=(frame_count, 10, 3)).astype(np.float32)
    units = UnitFrames(rng.normal(size=(frame_count, 3)), rng.uniform(1.0, 2.0, frame_count))
    changing, whole = ChangingBlock((frame_count, 10), units, device), UnitBlock(points, units, device)
    order = rng.permutation(10)
    for vertex in (order[:4], order[4:]):
        changing.put(vertex, points[:, vertex])
    assert np.array_equal(changing.double.numpy(), whole.double.numpy())
    assert np.array_equal(changing.lanes.numpy(), whole.lanes.numpy())


@pytest.mark.parametrize("frame_count", [1, 3, 21])
def test_the_longest_edge_of_a_face_is_that_of_the_frame_in_which_it_is_longest(frame_count, device):
    rng = np.random.default_rng(5)
    own, _, block, _ = blocks(rng, frame_count, device)
    corner = own[:, FACES].astype(np.float64)
    expected = np.linalg.norm(corner - np.roll(corner, 1, axis=2), axis=3).max(axis=(0, 2))
    np.testing.assert_allclose(longest_edges(block, FACES, device), expected, rtol=1e-5)
