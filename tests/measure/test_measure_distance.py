"""Closest points: against brute force over all faces, at small distances, on degenerate faces."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import Delaunay

from tests.support import meshes
from warpqem.errors import DegenerateMeshError
from warpqem.measure import compare
from warpqem.measure.closest_points import ClosestPointSearch


def closest_by_brute_force(points, faces, queries):
    distance = np.empty(len(queries))
    for i, query in enumerate(queries):
        candidates = trimesh.triangles.closest_point(points[faces], np.tile(query, (len(faces), 1)))
        distance[i] = np.linalg.norm(candidates - query, axis=1).min()
    return distance


def random_mesh(seed):
    random = np.random.default_rng(seed)
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=0.3)
    return mesh.vertices + random.normal(0, 0.02, mesh.vertices.shape), np.asarray(mesh.faces)


@pytest.mark.parametrize("spread", [1.0, 0.3, 0.01])
def test_closest_points_match_brute_force(device, spread):
    points, faces = random_mesh(1)
    random = np.random.default_rng(2)
    on_surface = points[faces].mean(axis=1)[random.integers(len(faces), size=200)]
    queries = on_surface + random.normal(0, spread, on_surface.shape)
    found = ClosestPointSearch(faces, device, "test").closest(points, queries, 0)
    np.testing.assert_allclose(found.distance, closest_by_brute_force(points, faces, queries), rtol=1e-6, atol=1e-12)


def test_barycentric_coordinates_give_the_distance(device):
    points, faces = random_mesh(3)
    queries = np.random.default_rng(4).normal(0, 0.5, (100, 3))
    found = ClosestPointSearch(faces, device, "test").closest(points, queries, 0)
    position = np.einsum("si,sij->sj", found.barycentric, points[faces[found.face]])
    assert found.barycentric.min() >= -1e-15
    np.testing.assert_allclose(found.barycentric.sum(axis=1), 1, atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(position - queries, axis=1), found.distance, rtol=1e-12)


@pytest.mark.parametrize("height", [1e-5, 1e-8, 1e-11])
def test_small_distances_are_right_beyond_single_precision(device, height):
    points, faces = np.array([[-0.3, -0.3, 0.1], [0.4, -0.3, 0.1], [0, 0.4, 0.1]]), np.array([[0, 1, 2]])
    queries = np.array([[0.01, 0.02, 0.1 + height], [0.1, -0.1, 0.1 - height]])
    found = ClosestPointSearch(faces, device, "test").closest(points, queries, 0)
    np.testing.assert_allclose(found.distance, height, rtol=1e-5)


def test_nearest_of_two_faces_closer_than_single_precision_apart(device):
    gap = 1e-9
    square = np.array([[-0.3, -0.3, 0.2], [0.4, -0.3, 0.2], [0, 0.4, 0.2]])
    points = np.concatenate([square, square + np.array([0, 0, gap])])
    queries = np.array([[0, 0, 0.2 - gap], [0, 0, 0.2 + 2 * gap]])
    found = ClosestPointSearch(np.array([[0, 1, 2], [3, 4, 5]]), device, "test").closest(points, queries, 0)
    assert found.face.tolist() == [0, 1]


def test_face_without_area_is_found_near_it(device):
    points = np.array([[-0.5, 0, 0], [0, 0, 0], [0, 0.1, 0], [0.3, 0, 0], [0.5, 0, 0]])
    faces = np.array([[0, 1, 2], [1, 3, 4]])
    beside = np.array([[0.0003, -0.0005, 0]])
    found = ClosestPointSearch(faces, device, "test").closest(points, beside, 0)
    assert found.face[0] == 1
    assert found.distance[0] == pytest.approx(0.0005, rel=1e-12)


def test_mesh_of_slivers_only_is_refused_with_its_frame(device):
    points = np.array([[0, 0, 0], [0.5, 0, 0], [1, 0, 0]])
    with pytest.raises(DegenerateMeshError, match=r"test mesh.*frame 7"):
        ClosestPointSearch(np.array([[0, 1, 2]]), device, "test").closest(points, np.ones((1, 3)), 7)


@pytest.mark.parametrize("seed", range(1, 6))
def test_two_ways_to_cut_a_flat_sheet_into_slivers_are_no_distance_apart(seed, device):
    # Points moved by a few of the steps that single precision has there: faces whose edges all but coincide.
    points, faces = meshes.grid(20, 20)
    rng = np.random.default_rng(seed)
    inner = ((points[:, :2] > 0) & (points[:, :2] < 1)).all(axis=1)
    moved = points.copy()
    moved[inner, :2] += rng.choice([0, 3e-8, -3e-8, 6e-8], size=(inner.sum(), 2)).astype(np.float32)
    moved = moved[~inner | (rng.random(len(points)) < 0.4)]
    other = Delaunay(moved[:, :2].astype(float)).simplices.astype(np.int32)
    other = other[trimesh.triangles.area(moved[other].astype(float)) > 0]
    assert compare(points, faces, moved, other, samples=500, device=device).hausdorff < 1e-4


@pytest.mark.parametrize("frame_count", [1, 2])
def test_large_face_over_thousands_in_its_plane_is_no_further_than_its_points(device, frame_count):
    """Two faces over 4802: one search gave a face up, and what bounded it was its own size, 16 to 36 % off."""
    square, pair = meshes.grid(1, 1)
    points, faces = meshes.grid(49, 49)
    frames, pairs = (np.stack([one * (1 + 0.1 * frame) for frame in range(frame_count)]) for one in (points, square))
    found = compare(frames, faces, pairs, pair, device=device)
    assert found.hausdorff < 1e-4
    lifted = pairs + np.array([0.0, 0.0, 0.01])
    found = compare(frames, faces, lifted, pair, device=device)
    assert found.hausdorff == pytest.approx(100 * 0.01 / np.sqrt(2), rel=1e-3)
