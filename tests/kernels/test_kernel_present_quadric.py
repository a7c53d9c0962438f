"""Quadrics of the present faces."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

import warpqem
from tests.oracles import quadrics as oracle
from tests.support import meshes
from tests.support.mesh_state import build_mesh, cost_model, one_part, packed
from warpqem.decimation.initial_quadrics import CONSTRAINT_WEIGHT
from warpqem.kernels.edge_cost import compute_all_costs, update_neighbourhood_costs
from warpqem.kernels.lanes import width_of
from warpqem.kernels.memoryless_quadric import LineWeights, renew_quadrics
from warpqem.kernels.topology import SEAM
from warpqem.measure import compare

MESHES = {
    "closed": meshes.swaying_sphere(1, 3),
    "open": meshes.bending_bar(6, 4, 3),
    "bow_tie": (meshes.bow_tie()[0][None], meshes.bow_tie()[1]),
}
PASS = 4


def around(mesh, masked, device):
    """A mask of vertices, and the number of the pass that made it."""
    mask = np.zeros(len(mesh.position), dtype=np.int32)
    mask[masked] = PASS
    return [wp.array(mask, device=device), wp.array([PASS], dtype=wp.int32, device=device)]


def renew(mesh, masked, device):
    weights = LineWeights()
    weights.border, weights.seam = CONSTRAINT_WEIGHT[1], CONSTRAINT_WEIGHT[2]
    inputs = [mesh.state, mesh.frames, weights, *around(mesh, masked, device), one_part(device)]
    wp.launch(renew_quadrics[width_of(mesh.frames.position)], dim=1, inputs=inputs, device=device)


def expected(points, faces):
    return np.array([[oracle.pack(q) for q in oracle.vertex_quadrics(x, faces)] for x in points]).transpose(1, 0, 2)


@pytest.mark.parametrize("name", MESHES)
def test_quadrics_are_those_of_the_faces_as_they_lie(name, device):
    points, faces = MESHES[name]
    mesh = build_mesh(points, faces, device)
    moved = points + 0.05 * np.random.default_rng(1).normal(size=points.shape)
    wp.copy(mesh.frames.position, packed(moved, device))
    renew(mesh, slice(None), device)
    np.testing.assert_allclose(mesh.quadric, expected(moved, faces), rtol=1e-3, atol=1e-5)


def test_seams_count_as_where_quadrics_begin(device):
    points, faces = meshes.grid(4, 4)
    seam = np.zeros(faces.size, dtype=np.int32)
    edge = {5, 6}
    for half_edge in range(faces.size):
        ends = {faces.ravel()[half_edge], faces.ravel()[half_edge - half_edge % 3 + (half_edge + 1) % 3]}
        seam[half_edge] = ends == edge
    assert seam.sum() == 2
    mesh = build_mesh(points, faces, device)
    before = mesh.quadric.copy()
    mesh.state.seam = wp.array(seam, device=device)
    flags = mesh.state.vertex_flags.numpy()
    flags[list(edge)] |= int(SEAM)
    mesh.state.vertex_flags.assign(flags)
    renew(mesh, slice(None), device)
    changed = np.flatnonzero(np.abs(mesh.quadric - before).max(axis=(1, 2)) > 1e-4)
    assert set(changed) == edge
    # The plane stands on the edge, so that it holds what moves across it within the grid; it is met in both faces.
    length = np.linalg.norm(points[5] - points[6])
    trace = (mesh.quadric - before)[5, 0, [0, 3, 5]].sum()
    assert trace == pytest.approx(2 * CONSTRAINT_WEIGHT[2] * length**2, rel=1e-3)


def test_scaled_vertices_weigh_their_present_planes_alike(device):
    points, faces = MESHES["closed"]
    mesh = build_mesh(points, faces, device)
    mesh.state.quadric_scale = wp.full(points.shape[1], 3.0, dtype=wp.float32, device=device)
    renew(mesh, slice(None), device)
    np.testing.assert_allclose(mesh.quadric, 3 * expected(points, faces), rtol=1e-3, atol=1e-5)


def test_vertices_that_the_pass_did_not_mask_keep_their_planes(device):
    points, faces = MESHES["closed"]
    mesh = build_mesh(points, faces, device)
    before = mesh.quadric.copy()
    wp.copy(mesh.frames.position, packed(2 * points, device))
    renew(mesh, [3], device)
    assert set(np.flatnonzero((mesh.quadric != before).any(axis=(1, 2)))) == {3}


def test_edges_at_masked_vertices_get_the_cost_of_all_edges(device):
    points, faces = MESHES["open"]
    mesh = build_mesh(points, faces, device)
    width = width_of(mesh.frames.position)
    inputs = [mesh.state, mesh.frames, cost_model()]
    wp.launch(compute_all_costs[width], dim=1, inputs=[*inputs, one_part(device)], device=device)
    costs = mesh.state.edge_cost.numpy().copy()
    mesh.state.edge_cost.fill_(-7.0)
    given = [*inputs, *around(mesh, [2, 9], device), one_part(device)]
    wp.launch(update_neighbourhood_costs[width], dim=1, inputs=given, device=device)
    ends = np.stack([faces.ravel(), np.roll(faces, -1, axis=1).ravel()])
    near = np.isin(ends, [2, 9]).any(axis=0)
    np.testing.assert_array_equal(mesh.state.edge_cost.numpy(), np.where(near, costs, np.float32(-7.0)))


def test_memoryless_order_fits_a_waving_cloth_better(device):
    time = np.arange(12)[:, None]
    points, faces = meshes.grid(24, 24)
    waves = np.sin(7 * points[:, 0] + 0.5 * time) * np.cos(5 * points[:, 1]) * 0.1
    cloth = np.repeat(points[None], len(time), axis=0)
    cloth[:, :, 2] += waves
    error = {}
    for memoryless in (False, True):
        # Without a refit, so that nothing but the order differs.
        result = warpqem.simplify(cloth, faces, ratio=0.1, memoryless=memoryless, refit=False, device=device)
        error[memoryless] = compare(cloth, faces, result.points, result.faces, samples=3000, device=device).rms
    assert error[True] < 0.97 * error[False]


def test_memoryless_order_gives_the_same_bits_again(device):
    points, faces = meshes.swaying_sphere(3, 4)
    first, second = (warpqem.simplify(points, faces, ratio=0.2, memoryless=True, device=device) for _ in range(2))
    assert np.array_equal(first.points, second.points)
    assert np.array_equal(first.faces, second.faces)
