"""Choice of a pass's candidates on meshes that are large enough for a sampled cap."""

import meshes
import numpy as np
import pytest
import warp as wp
from mesh_state import build_mesh, cost_model

import warpqem
from warpqem.order.pass_steps import PassSteps
from warpqem.order.passes import CAP_FRACTION, Orderer
from warpqem.order.stars import build_stars


@pytest.fixture
def orderer(device):
    """A priced mesh of 61440 half-edges."""
    points, faces = meshes.icosphere(5)
    mesh = build_mesh(points, faces, device)
    stars = build_stars(mesh.state.corner_vertex, len(points), mesh.state.face_count)
    orderer = Orderer(PassSteps(mesh.state, mesh.frames, stars, cost_model(), device))
    orderer.steps.price_all().run()
    return orderer


def only_awake(orderer, half_edge):
    cost = np.full(len(orderer.state.edge_cost), np.inf, dtype=np.float32)
    cost[half_edge] = 1.0
    orderer.state.edge_cost.assign(cost)


@pytest.mark.parametrize("half_edge", [7 * 100, 7 * 100 + 1, 7 * 100 + 6])
def test_pass_after_one_without_a_winner_sees_every_edge(half_edge, orderer):
    gear = orderer.steps.gear(1)
    assert orderer._collect_candidates(gear, CAP_FRACTION) > 0
    only_awake(orderer, half_edge)
    assert orderer._collect_candidates(gear, 4 * CAP_FRACTION) == 1


def test_sampled_cap_is_near_the_exact_one(orderer):
    cost = orderer.state.edge_cost.numpy()
    wanted = int(CAP_FRACTION * 1.5 * orderer.live_faces)
    count = orderer._collect_candidates(orderer.steps.gear(1), CAP_FRACTION)
    assert np.isfinite(cost).sum() > 10 * wanted
    # A bin is up to 6 % wide, and costs of a regular mesh lie close together.
    assert wanted // 2 <= count <= 4 * wanted


@pytest.fixture
def shared_from_the_first_face(monkeypatch):
    monkeypatch.setattr("warpqem.order.passes.SHARED_FACES", 0)


@pytest.mark.parametrize("mesh", [meshes.swaying_sphere(3, 4), meshes.waving_grid(24, 5)], ids=["closed", "open"])
def test_passes_shared_by_three_threads_end_as_those_of_one(mesh, monkeypatch, shared_from_the_first_face):
    results = []
    for threads in (1, 3):
        monkeypatch.setattr("warpqem.order.pass_steps.thread_count", lambda _, threads=threads: threads)
        results.append(warpqem.simplify(*mesh, ratio=0.2, device="cpu"))
    one, three = results
    np.testing.assert_array_equal(one.faces, three.faces)
    np.testing.assert_array_equal(one.points, three.points)
    np.testing.assert_array_equal(one.log.removed, three.log.removed)


def lists_of(stars, vertex_count):
    start, end, corner = (a.numpy() for a in (stars.start, stars.end, stars.corner))
    return [corner[start[v] : end[v]].tolist() for v in range(vertex_count)]


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("spare", [0, 300, 10**5], ids=["no room", "some room", "room"])
def test_stars_are_those_of_the_faces_after_every_pass(spare, threads, device, monkeypatch, shared_from_the_first_face):
    if wp.get_device(device).is_cpu:
        monkeypatch.setattr("warpqem.order.pass_steps.thread_count", lambda _: threads)
    points, faces = meshes.waving_grid(24, 3)
    mesh = build_mesh(points, faces, device)
    vertex_count = points.shape[1]
    stars = build_stars(mesh.state.corner_vertex, vertex_count, mesh.state.face_count, spare)
    mesh.state.stars = stars.lists
    orderer = Orderer(PassSteps(mesh.state, mesh.frames, stars, cost_model(key_count=3), device))
    orderer.steps.price_all().run()
    for _ in range(12):
        orderer._run_pass(200, CAP_FRACTION)
        fresh = build_stars(mesh.state.corner_vertex, vertex_count, mesh.state.face_count)
        assert lists_of(mesh.state.stars, vertex_count) == lists_of(fresh.lists, vertex_count)
