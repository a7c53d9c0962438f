"""Walks to the nearest point of a surface, its border and its seams, against a look at all faces and edges."""

import numpy as np
import pytest
import warp as wp

from tests.support import meshes
from warpqem.decimation.adjacency import build_adjacency
from warpqem.kernels.surface_walk import Surface, closest_hit, closest_line_hit, surface_point
from warpqem.measure.closest_points import ClosestPointSearch
from warpqem.refit.matching import make_surface


@wp.kernel
def walk(
    # in
    s: Surface,
    start: wp.array[wp.int32],
    query: wp.array[wp.vec3],
    # out
    squared: wp.array[wp.float32],
    point: wp.array[wp.vec3],
):
    i = wp.tid()
    hit = closest_hit(s, 0, wp.vec3i(start[i], -1, -1), -1, query[i])
    squared[i] = hit.squared
    if hit.face >= 0:
        point[i] = surface_point(s, 0, hit.face, hit.barycentric)


@wp.kernel
def walk_line(
    # in
    s: Surface,
    on_seams: wp.int32,
    start: wp.array[wp.int32],
    query: wp.array[wp.vec3],
    # out
    half_edge: wp.array[wp.int32],
    squared: wp.array[wp.float32],
):
    i = wp.tid()
    hit = closest_line_hit(s, on_seams, 0, start[i], query[i])
    half_edge[i] = hit.half_edge
    squared[i] = hit.squared


def surface_of(mesh, device, seam=None):
    points, faces = mesh
    corner_vertex = wp.array(faces.ravel(), dtype=wp.int32, device=device)
    key = wp.array(points[None].astype(np.float32), dtype=wp.vec3, device=device)
    return make_surface(key, corner_vertex, build_adjacency(corner_vertex, len(points)), seam)


def near_queries(mesh, count, device):
    """Points beside the surface, and a vertex near each."""
    points, faces = mesh
    random = np.random.default_rng(1)
    face = random.integers(len(faces), size=count)
    weight = random.dirichlet([1, 1, 1], size=count)
    query = np.einsum("qk,qkc->qc", weight, points[faces[face]]) + random.normal(scale=0.02, size=(count, 3))
    start = faces[face, random.integers(3, size=count)]
    arrays = wp.array(start, dtype=wp.int32, device=device), wp.array(query, dtype=wp.vec3, device=device)
    return query, arrays


@pytest.mark.parametrize("mesh", [meshes.icosphere(2), meshes.torus()], ids=["sphere", "torus"])
def test_walk_ends_at_the_nearest_point(mesh, device):
    query, inputs = near_queries(mesh, 200, device)
    squared = wp.zeros(200, dtype=wp.float32, device=device)
    point = wp.zeros(200, dtype=wp.vec3, device=device)
    wp.launch(walk, dim=200, inputs=[surface_of(mesh, device), *inputs], outputs=[squared, point], device=device)
    expected = ClosestPointSearch(mesh[1], device, "test").closest(mesh[0], query, 0).distance
    np.testing.assert_allclose(np.sqrt(squared.numpy()), expected, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(point.numpy() - query, axis=1), expected, atol=1e-5)


def test_walk_from_no_vertex_finds_no_face(device):
    mesh = meshes.icosphere(1)
    squared, point = wp.zeros(1, dtype=wp.float32, device=device), wp.zeros(1, dtype=wp.vec3, device=device)
    start = wp.array([-1], dtype=wp.int32, device=device)
    query = wp.array([[0, 0, 1]], dtype=wp.vec3, device=device)
    wp.launch(walk, dim=1, inputs=[surface_of(mesh, device), start, query], outputs=[squared, point], device=device)
    np.testing.assert_array_equal(point.numpy(), 0)


def nearest_distances(query, a, b):
    """(Q,) distances of points from the nearest of segments from (E, 3) to (E, 3)."""
    along = np.clip(((query[:, None] - a) * (b - a)).sum(-1) / ((b - a) ** 2).sum(-1), 0, 1)
    return np.linalg.norm(query[:, None] - a - along[..., None] * (b - a), axis=-1).min(axis=1)


def test_border_walk_ends_at_the_nearest_edge(device):
    points, faces = meshes.grid(7, 5)
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    directed = set(map(tuple, edges.tolist()))
    border = np.array([(u, v) not in directed or (v, u) not in directed for u, v in edges.tolist()])
    a, b = points[edges[border, 0]], points[edges[border, 1]]
    query = 0.5 * (a + b) + np.random.default_rng(0).normal(scale=0.02, size=a.shape)
    expected = nearest_distances(query, a, b)
    count = len(query)
    half_edge, squared = (wp.zeros(count, dtype=t, device=device) for t in (wp.int32, wp.float32))
    start = wp.array(edges[border, 0], dtype=wp.int32, device=device)
    inputs = [surface_of((points, faces), device), start, wp.array(query, dtype=wp.vec3, device=device)]
    wp.launch(walk_line, dim=count, inputs=[inputs[0], 0, *inputs[1:]], outputs=[half_edge, squared], device=device)
    np.testing.assert_allclose(np.sqrt(squared.numpy()), expected, atol=1e-5)
    assert set(half_edge.numpy()) <= set(np.flatnonzero(border))


def test_border_walk_from_the_inside_finds_no_edge(device):
    mesh = meshes.grid(4, 4)
    surface = surface_of(mesh, device)
    inside = int(np.flatnonzero(surface.border_out.numpy() < 0)[0])
    half_edge, squared = (wp.zeros(1, dtype=t, device=device) for t in (wp.int32, wp.float32))
    start = wp.array([inside], dtype=wp.int32, device=device)
    query = wp.zeros(1, dtype=wp.vec3, device=device)
    wp.launch(walk_line, dim=1, inputs=[surface, 0, start, query], outputs=[half_edge, squared], device=device)
    assert half_edge.numpy()[0] == -1


def test_seam_walk_goes_over_forks(device):
    points, faces = meshes.grid(8, 8)
    # Two seams that cross in the middle of the grid.
    a, b = points[faces], points[np.roll(faces, -1, axis=1)]
    seam = ((a[:, :, 0] == 0.5) & (b[:, :, 0] == 0.5)) | ((a[:, :, 1] == 0.5) & (b[:, :, 1] == 0.5))
    first, last = a[seam], b[seam]
    far = np.flatnonzero((points[:, :2] == [0.5, 0.0]).all(axis=1))
    query = np.array([[0.9, 0.52, 0.0], [0.1, 0.47, 0.0], [0.51, 0.9, 0.1]])
    half_edge, squared = (wp.zeros(3, dtype=t, device=device) for t in (wp.int32, wp.float32))
    surface = surface_of((points, faces), device, seam.ravel())
    inputs = [surface, 1, wp.array(np.repeat(far, 3), dtype=wp.int32, device=device)]
    query_in = wp.array(query, dtype=wp.vec3, device=device)
    wp.launch(walk_line, dim=3, inputs=[*inputs, query_in], outputs=[half_edge, squared], device=device)
    np.testing.assert_allclose(np.sqrt(squared.numpy()), nearest_distances(query, first, last), atol=1e-5)
    assert seam.ravel()[half_edge.numpy()].all()
