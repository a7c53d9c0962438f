"""Cost, anchor and placement of an edge collapse over frames."""

import numpy as np
import pytest
import warp as wp

from tests.oracles import edge_cost as oracle
from tests.oracles import motion as motion_oracle
from tests.oracles.quadrics import vertex_quadrics
from tests.oracles.topology import edges
from tests.support import meshes
from tests.support.mesh_state import (
    blocks,
    build_mesh,
    collapse_log,
    cost_model,
    edge_list,
    half_edge_between,
    one_part,
    packed,
)
from warpqem.decimation.adjacency import build_adjacency
from warpqem.kernels.collapse import commit_collapses
from warpqem.kernels.edge_cost import compute_all_costs, resume_neighbourhoods, update_moved_costs
from warpqem.kernels.lanes import width_of
from warpqem.kernels.legality import place_collapses
from warpqem.kernels.topology import CORNER, SEAM

MESHES = {"closed": meshes.swaying_sphere(1, 3), "open": meshes.bending_bar(6, 5, 4)}
EPSILON = 0.1


def costs_of(mesh, model, device) -> np.ndarray:
    inputs = [mesh.state, mesh.frames, model, one_part(device)]
    wp.launch(compute_all_costs[width_of(mesh.frames.position)], dim=1, inputs=inputs, device=device)
    return mesh.state.edge_cost.numpy().copy()


def placed(mesh, model, half_edges, device):
    """(targets (E, K, 3), anchors (E,)) of the half-edges."""
    selected = edge_list(half_edges, device)
    shape = (len(half_edges), mesh.frames.position.shape[1])
    target = wp.empty(shape, dtype=mesh.frames.position.dtype, device=device)
    anchor = wp.empty(len(half_edges), dtype=wp.float32, device=device)
    inputs = [mesh.state, mesh.frames, model, selected, one_part(device)]
    wp.launch(place_collapses[width_of(target)], dim=1, inputs=inputs, outputs=[target, anchor], device=device)
    return blocks(target, mesh.key_count), anchor.numpy()


def edge_data(points, faces, u, v):
    """Quadrics and positions of both ends over the frames, float64."""
    quadrics = [vertex_quadrics(x, faces) for x in points]
    x = points.astype(np.float64)
    return [q[u] for q in quadrics], [q[v] for q in quadrics], x[:, u], x[:, v]


def inner_edges(faces):
    """Half-edges from lower to higher vertex whose ends are both on the border or both inside."""
    border = {v for e, s in motion_oracle.edge_opposites(faces).items() if len(s) == 1 for v in e}
    found = [e for e, s in motion_oracle.edge_opposites(faces).items() if (e[0] in border) == (e[1] in border)]
    return [
        (u, v, half_edge_between(faces, u, v)) for u, v in found if len(motion_oracle.edge_opposites(faces)[u, v]) == 2
    ]


@pytest.mark.parametrize("name", MESHES)
def test_every_edge_gets_its_cost_once(name, device):
    points, faces = MESHES[name]
    cost = costs_of(build_mesh(points, faces, device), cost_model(), device)
    assert np.isfinite(cost).sum() == len(edges(faces))
    assert (cost[np.isfinite(cost)] > 0).all()


@pytest.mark.parametrize("name", MESHES)
def test_anchor_minimises_the_sum_over_frames(name, device):
    points, faces = MESHES[name]
    picked = inner_edges(faces)[::7]
    _, anchor = placed(build_mesh(points, faces, device), cost_model(EPSILON), [h for *_, h in picked], device)
    expected = [oracle.edge_anchor(*edge_data(points, faces, u, v)) for u, v, _ in picked]
    np.testing.assert_allclose(anchor, expected, atol=2e-3)


@pytest.mark.parametrize("name", MESHES)
def test_cost_and_targets_match_the_oracle(name, device):
    points, faces = MESHES[name]
    picked = inner_edges(faces)[::7]
    mesh, model = build_mesh(points, faces, device), cost_model(EPSILON)
    cost = costs_of(mesh, model, device)
    target, anchor = placed(mesh, model, [h for *_, h in picked], device)
    for i, (u, v, h) in enumerate(picked):
        expected, _, positions = oracle.edge_cost(*edge_data(points, faces, u, v), float(anchor[i]), EPSILON)
        assert cost[h] == pytest.approx(expected, rel=1e-3, abs=1e-9)
        np.testing.assert_allclose(target[i], positions, atol=1e-5)


def test_weight_multiplies_the_cost_as_the_mean_of_both_ends(device):
    points, faces = MESHES["closed"]
    weight = np.ones(points.shape[1])
    weight[faces[0, 0]] = 5
    u, v = sorted(faces[0, :2].tolist())
    h = half_edge_between(faces, u, v)
    plain = costs_of(build_mesh(points, faces, device), cost_model(), device)[h]
    weighted = costs_of(build_mesh(points, faces, device, cost_weight=weight), cost_model(), device)[h]
    assert weighted == pytest.approx(3 * plain, rel=1e-5)


def test_border_vertex_is_the_anchor_of_an_edge_to_the_inside(device):
    points, faces = meshes.waving_grid(4, 3)
    out, back = half_edge_between(faces, 2, 7), half_edge_between(faces, 7, 2)
    _, anchor = placed(build_mesh(points, faces, device), cost_model(), [out, back], device)
    np.testing.assert_array_equal(anchor, [0, 1])


def test_locked_vertex_is_the_target_in_every_frame(device):
    points, faces = MESHES["closed"]
    u, v = faces[0, :2].tolist()
    h = half_edge_between(faces, u, v)
    target, anchor = placed(build_mesh(points, faces, device, locked=[v]), cost_model(), [h], device)
    assert anchor[0] == 1
    np.testing.assert_allclose(target[0], points[:, v], atol=1e-7)


def test_endpoint_placement_takes_the_end_with_the_lower_sum(device):
    points, faces = MESHES["closed"]
    picked = inner_edges(faces)[::5]
    model = cost_model(endpoint=True)
    _, anchor = placed(build_mesh(points, faces, device), model, [h for *_, h in picked], device)
    for (u, v, _), chosen in zip(picked, anchor, strict=True):
        data = edge_data(points, faces, u, v)
        values = [sum(oracle.merged(*frame, end).c for frame in zip(*data, strict=True)) for end in (0.0, 1.0)]
        assert values[int(chosen)] <= min(values) * (1 + 1e-4) + 1e-9


def test_anchor_of_a_flat_edge_is_its_middle(device):
    points, faces = meshes.grid(4, 4)
    _, anchor = placed(build_mesh(points, faces, device), cost_model(), [half_edge_between(faces, 7, 12)], device)
    assert anchor[0] == pytest.approx(0.5, abs=1e-5)


def test_short_edges_of_a_flat_mesh_are_cheaper(device):
    points, faces = meshes.grid(5, 5)
    cost = costs_of(build_mesh(points, faces, device), cost_model(), device)
    side, diagonal = half_edge_between(faces, 14, 15), half_edge_between(faces, 15, 20)
    assert 0 < cost[side] < cost[diagonal]


def test_edge_between_two_locked_vertices_may_not_collapse(device):
    points, faces = MESHES["closed"]
    u, v = sorted(faces[0, :2].tolist())
    cost = costs_of(build_mesh(points, faces, device, locked=[u, v]), cost_model(), device)
    assert np.isinf(cost[half_edge_between(faces, u, v)])
    assert np.isinf(cost).sum() == faces.size - len(edges(faces)) + 1


def test_edges_from_a_non_manifold_vertex_to_a_border_may_not_collapse(device):
    points, faces = meshes.double_cone(6)
    cost = costs_of(build_mesh(points, faces, device), cost_model(), device)
    at_tip = (faces.ravel() == 0) | (np.roll(faces, -1, axis=1).ravel() == 0)
    assert np.isinf(cost[at_tip]).all()
    assert np.isfinite(cost[~at_tip]).all()


def test_edges_from_a_non_manifold_vertex_inwards_cost_what_ending_there_does(device):
    points, faces = meshes.welded(meshes.joined(meshes.icosphere(1), meshes.icosphere(1), spacing=1.0), {42: 0})
    mesh = build_mesh(points, faces, device)
    cost = costs_of(mesh, cost_model(), device)
    ends = np.stack([faces.ravel(), np.roll(faces, -1, axis=1).ravel()])
    half_edge = np.flatnonzero((ends == 0).any(axis=0) & (ends[0] < ends[1]))
    assert np.isfinite(cost[half_edge]).all()
    target, _ = placed(mesh, cost_model(), half_edge, device)
    np.testing.assert_array_equal(target, np.broadcast_to(points[None, 0], target.shape))


def test_edges_above_the_error_limit_may_not_collapse(device):
    points, faces = MESHES["closed"]
    mesh = build_mesh(points, faces, device)
    everything = np.isfinite(costs_of(mesh, cost_model(EPSILON), device))
    limit = 1e-3
    limited = np.isfinite(costs_of(mesh, cost_model(EPSILON, error_limit=limit), device))
    _, anchor = placed(mesh, cost_model(EPSILON), np.flatnonzero(everything), device)
    for h, lam in zip(np.flatnonzero(everything), anchor, strict=True):
        u, v = faces.ravel()[h], np.roll(faces, -1, axis=1).ravel()[h]
        _, error, _ = oracle.edge_cost(*edge_data(points, faces, u, v), float(lam), EPSILON)
        if abs(error - limit) > 0.01 * limit:
            assert limited[h] == (error < limit)
    assert 0 < limited.sum() < everything.sum()


def test_deformation_is_added_with_its_weight(device):
    points, faces = MESHES["open"]
    u, v, h = inner_edges(faces)[3]
    mesh = build_mesh(points, faces, device, with_trajectory=True)
    plain = costs_of(mesh, cost_model(), device)[h]
    with_term = costs_of(mesh, cost_model(deformation_weight=2.0), device)[h]
    expected = 2 * motion_oracle.length_deformation(points, faces, u, v)
    assert with_term - plain == pytest.approx(expected, rel=1e-2)
    assert expected > 0


def commit_one(mesh, half_edge, target, device):
    """Collapse one half-edge; the log of it, the mask, and the pass's number, 1."""
    vertex_count = len(mesh.state.vertex_flags)
    log = collapse_log(vertex_count, device)
    selected = edge_list([half_edge], device)
    mask, slot = (wp.zeros(n, dtype=wp.int32, device=device) for n in (vertex_count, 1))
    one = wp.array([1], dtype=wp.int32, device=device)
    removed = wp.array([2], dtype=wp.int32, device=device)
    anchor = wp.array([0.5], dtype=wp.float32, device=device)
    blocks_in = packed(target.transpose(1, 0, 2), device)
    error = wp.zeros(1, dtype=wp.float32, device=device)
    inputs = [mesh.state, mesh.frames, selected, removed, blocks_in, anchor, error, one, one_part(device)]
    wp.launch(
        commit_collapses[width_of(blocks_in)],
        dim=1,
        inputs=inputs,
        outputs=[mask, log, slot, wp.clone(mesh.state.adjacency.used)],
        device=device,
    )
    log.count.fill_(1)
    return log, mask, one


def rebuilt(mesh, device):
    """New adjacency after a commit."""
    adjacency = build_adjacency(mesh.state.corner_vertex, len(mesh.state.vertex_flags))
    mesh.state.adjacency = adjacency.lists
    return mesh


@pytest.mark.parametrize("threads", [1, 3, 8, 61])
def test_updating_moved_costs_equals_computing_all(threads, device):
    points, faces = MESHES["closed"]
    mesh, model = build_mesh(points, faces, device), cost_model()
    costs_of(mesh, model, device)
    h = half_edge_between(faces, *sorted(faces[0, :2].tolist()))
    log, *_ = commit_one(mesh, h, placed(mesh, model, [h], device)[0], device)
    rebuilt(mesh, device)
    begin = wp.zeros(1, dtype=wp.int32, device=device)
    work = one_part(device)
    work.thread_count = threads
    inputs = [mesh.state, mesh.frames, model, log, begin, work]
    wp.launch(update_moved_costs[width_of(mesh.frames.position)], dim=threads, inputs=inputs, device=device)
    updated = mesh.state.edge_cost.numpy().copy()
    np.testing.assert_array_equal(updated, costs_of(mesh, model, device))


def test_suspended_edges_resume_around_a_moved_vertex_only(device):
    points, faces = meshes.swaying_sphere(2, 2)
    mesh, model = build_mesh(points, faces, device), cost_model()
    suspended = -costs_of(mesh, model, device)
    mesh.state.edge_cost.assign(suspended)
    u, v = sorted(faces[0, :2].tolist())
    h = half_edge_between(faces, u, v)
    _, mask, number = commit_one(mesh, h, placed(mesh, model, [h], device)[0], device)
    wp.launch(resume_neighbourhoods, dim=1, inputs=[mesh.state, mask, number, one_part(device)], device=device)
    corner = mesh.state.corner_vertex.numpy().reshape(-1, 3)
    live = corner[corner[:, 0] >= 0]
    ring = np.unique(live[(live == u).any(axis=1)])
    tail, head = corner.ravel(), np.roll(corner, -1, axis=1).ravel()
    near = np.isin(tail, ring) | np.isin(head, ring)
    cost = mesh.state.edge_cost.numpy()
    finite = np.isfinite(cost) & (tail >= 0)
    assert (cost[finite & near] > 0).all()
    assert (cost[finite & ~near] < 0).all()
    assert (finite & ~near).any()


def with_seams(faces, pairs, corners, device):
    """A still 4 x 4 grid with seams along vertex pairs and the given corners."""
    built = build_mesh(meshes.grid(4, 4)[0], faces, device)
    half_edges = [half_edge_between(faces, *ends) for u, v in pairs for ends in ((u, v), (v, u))]
    seam = np.zeros(faces.size, dtype=np.int32)
    seam[half_edges] = 1
    flags = built.state.vertex_flags.numpy()
    flags[np.unique(pairs)] |= int(SEAM)
    flags[list(corners)] |= int(CORNER)
    built.state.seam = wp.array(seam, device=device)
    built.state.vertex_flags = wp.array(flags, device=device)
    return built


@pytest.mark.parametrize(
    ("pairs", "corners", "costly"),
    [
        ([(6, 7), (7, 8)], (), False),  # along a seam
        ([(6, 7), (7, 8)], (6,), False),  # along a seam to its corner
        ([(6, 7), (7, 8)], (6, 7), True),  # from corner to corner
        ([(1, 6), (2, 7)], (), True),  # from seam to seam across the surface
        ([(6, 7), (7, 11), (11, 6)], (), True),  # the whole of an island
    ],
)
def test_collapse_that_changes_how_seams_run_is_costly(pairs, corners, costly, device):
    _, faces = meshes.grid(4, 4)
    built = with_seams(faces, pairs, corners, device)
    edge = half_edge_between(faces, 6, 7)
    # The grid is flat: all that a collapse costs is length.
    free = costs_of(build_mesh(meshes.grid(4, 4)[0], faces, device), cost_model(), device)[edge]
    assert (costs_of(built, cost_model(), device)[edge] > 100 * free) == costly


def edges_around(faces, chosen):
    """Vertex pairs around some faces: the ends of edges that one of them alone has."""
    edges = np.sort(np.stack([faces[chosen], np.roll(faces[chosen], -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    pairs, count = np.unique(edges, axis=0, return_counts=True)
    return pairs[count == 1].tolist()


@pytest.mark.parametrize("kind", ["triangle", "quadrilateral", "at the border"])
def test_last_faces_of_an_island_cost_more_than_two_seams_that_are_joined(kind, device):
    _, faces = meshes.grid(4, 4)
    u, v = (1, 2) if kind == "at the border" else (6, 7)
    inside = [f for f, face in enumerate(faces.tolist()) if {u, v} <= set(face)]
    assert len(inside) == (1 if kind == "at the border" else 2)
    island = inside[:1] if kind == "triangle" else inside
    tail, head = faces.ravel().tolist(), np.roll(faces, -1, axis=1).ravel().tolist()
    directed = set(zip(tail, head, strict=True))
    seams = [(a, b) for a, b in edges_around(faces, island) if {(a, b), (b, a)} <= directed]
    edge = half_edge_between(faces, *((u, v) if (u, v) in directed else (v, u)))
    flat = meshes.grid(4, 4)[0]
    taken = costs_of(with_seams(faces, seams, (), device), cost_model(), device)[edge]
    two_lines = [(u, u + 5), (v, v + 5)]
    joined = costs_of(with_seams(faces, two_lines, (), device), cost_model(), device)[edge]
    free = costs_of(build_mesh(flat, faces, device), cost_model(), device)[edge]
    assert taken - free == pytest.approx(4 * (joined - free), rel=1e-3)


def test_corner_of_a_seam_is_the_anchor_against_the_rest_of_it(device):
    _, faces = meshes.grid(4, 4)
    built = with_seams(faces, [(6, 7), (7, 8)], (6,), device)
    _, anchor = placed(built, cost_model(), [half_edge_between(faces, 6, 7), half_edge_between(faces, 7, 6)], device)
    assert anchor.tolist() == [0.0, 1.0]


def test_cost_of_one_frame_is_its_quadric_error_and_that_of_several_their_sum(device):
    # QEM (Garland & Heckbert 1997) and DSD (Mohr & Gleicher 2003): v^T Q v about the world's origin.
    points, faces = MESHES["closed"]
    picked = inner_edges(faces)[::5]
    half_edges = [h for *_, h in picked]
    for frames in (points[:1], points):
        mesh, model = build_mesh(frames, faces, device), cost_model(1e-3)
        cost = costs_of(mesh, model, device)
        target, _ = placed(mesh, model, half_edges, device)
        quadrics = [vertex_quadrics(x, faces, origin=np.zeros_like(x, dtype=np.float64)) for x in frames]
        for i, (u, v, h) in enumerate(picked):
            expected = sum((q[u] + q[v])(target[i, t].astype(np.float64)) for t, q in enumerate(quadrics))
            assert cost[h] == pytest.approx(expected, rel=2e-3, abs=1e-7)
