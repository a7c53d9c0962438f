"""Initial quadrics per vertex and frame."""

import numpy as np
import pytest
import warp as wp

from tests.oracles import quadrics as oracle
from tests.support import meshes
from tests.support.mesh_state import blocks, build_mesh, listed_edges, packed
from warpqem.decimation.adjacency import build_adjacency, classify_vertices
from warpqem.decimation.initial_quadrics import CONSTRAINT_WEIGHT, constraint_weights, initial_quadrics
from warpqem.kernels.lanes import width_of
from warpqem.kernels.plane_quadrics import weigh_face_normals

MESHES = {
    "closed": meshes.swaying_sphere(1, 3),
    "open": meshes.bending_bar(6, 4, 3),
    "flat": (meshes.grid(3, 3)[0][None], meshes.grid(3, 3)[1]),
    "bow_tie": (meshes.bow_tie()[0][None], meshes.bow_tie()[1]),
}


@pytest.mark.parametrize("name", MESHES)
def test_vertex_quadrics_match_the_oracle(name, device):
    points, faces = MESHES[name]
    quadric = build_mesh(points, faces, device).quadric
    expected = np.array([[oracle.pack(q) for q in oracle.vertex_quadrics(x, faces)] for x in points])
    np.testing.assert_allclose(quadric, expected.transpose(1, 0, 2), rtol=1e-4, atol=1e-6)


def test_weighted_normal_squares_to_the_area(device):
    points, faces = MESHES["open"]
    position = packed(points, device)
    out = wp.empty((len(faces), position.shape[1]), dtype=position.dtype, device=device)
    inputs = [wp.array(faces.ravel(), dtype=wp.int32, device=device), position]
    wp.launch(weigh_face_normals[width_of(position)], dim=out.shape, inputs=inputs, outputs=[out], device=device)
    corner = points.astype(np.float64)[:, faces]
    area = np.linalg.norm(np.cross(corner[:, :, 1] - corner[:, :, 0], corner[:, :, 2] - corner[:, :, 0]), axis=2) / 2
    np.testing.assert_allclose((blocks(out, len(points)) ** 2).sum(axis=2).T, area, rtol=1e-4)


def test_face_without_area_adds_no_plane(device):
    points = np.array([[0, 0, 0], [0.5, 0, 0], [1, 0, 0]], dtype=np.float32)
    quadric = build_mesh(points, np.array([[0, 1, 2]]), device).quadric
    np.testing.assert_array_equal(quadric, 0)


def test_quadric_scale_multiplies_the_vertex_quadric(device):
    points, faces = MESHES["open"]
    corner_vertex = wp.array(faces.ravel(), dtype=wp.int32, device=device)
    adjacency = build_adjacency(corner_vertex, points.shape[1])
    border = classify_vertices(corner_vertex, adjacency, wp.zeros(points.shape[1], dtype=wp.int32, device=device))
    edges = listed_edges(corner_vertex, border, wp.zeros_like(border))
    position = packed(points, device)
    scales = [np.ones(points.shape[1]), np.full(points.shape[1], 4.0)]
    once, fourfold = (
        initial_quadrics(
            corner_vertex, adjacency, edges, position, wp.array(s, dtype=wp.float32, device=device)
        ).numpy()
        for s in scales
    )
    np.testing.assert_array_equal(fourfold, 4 * once)


def test_seams_of_many_small_islands_weigh_less_each():
    few, many = constraint_weights(10, 1000), constraint_weights(600, 1000)
    assert few == CONSTRAINT_WEIGHT
    assert many == {1: CONSTRAINT_WEIGHT[1], 2: pytest.approx(CONSTRAINT_WEIGHT[2] / 4)}
