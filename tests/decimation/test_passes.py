"""Choice of a pass's candidates on meshes that are large enough for a sampled threshold."""

import numpy as np
import pytest
import warp as wp

import warpqem
from tests.support import meshes
from tests.support.mesh_state import build_mesh, cost_model
from warpqem.decimation.adjacency import build_adjacency
from warpqem.decimation.pass_steps import PassSteps
from warpqem.decimation.passes import CANDIDATE_FRACTION, Orderer
from warpqem.decimation.recorded_launches import part_work


@pytest.fixture
def orderer(device):
    """A mesh of 61440 half-edges with their costs."""
    points, faces = meshes.icosphere(5)
    mesh = build_mesh(points, faces, device)
    orderer = Orderer(PassSteps(mesh.state, mesh.frames, mesh.adjacency, cost_model(), device))
    orderer.steps.compute_all_costs()
    return orderer


def only_resumed(orderer, half_edge):
    cost = np.full(len(orderer.state.edge_cost), np.inf, dtype=np.float32)
    cost[half_edge] = 1.0
    orderer.state.edge_cost.assign(cost)


@pytest.mark.parametrize("half_edge", [7 * 100, 7 * 100 + 1, 7 * 100 + 6])
def test_pass_after_one_without_a_collapse_sees_every_edge(half_edge, orderer):
    launches = orderer.steps.launches(1)
    assert orderer._collect_candidates(launches, CANDIDATE_FRACTION) > 0
    only_resumed(orderer, half_edge)
    assert orderer._collect_candidates(launches, 4 * CANDIDATE_FRACTION) == 1


def test_sampled_threshold_is_near_the_exact_one(orderer):
    cost = orderer.state.edge_cost.numpy()
    wanted = int(CANDIDATE_FRACTION * 1.5 * orderer.live_faces)
    count = orderer._collect_candidates(orderer.steps.launches(1), CANDIDATE_FRACTION)
    assert np.isfinite(cost).sum() > 10 * wanted
    # A bin is up to 6 % wide, and costs of a regular mesh lie close together.
    assert wanted // 2 <= count <= 4 * wanted


@pytest.fixture
def shared_from_the_first_face(monkeypatch):
    monkeypatch.setattr("warpqem.decimation.passes.SHARED_FACES", 0)


@pytest.mark.parametrize("mesh", [meshes.swaying_sphere(3, 4), meshes.waving_grid(24, 5)], ids=["closed", "open"])
def test_passes_shared_by_three_threads_end_as_those_of_one(mesh, monkeypatch, shared_from_the_first_face):
    results = []
    for threads in (1, 3):
        monkeypatch.setattr("warpqem.decimation.pass_steps.thread_count", lambda _, threads=threads: threads)
        results.append(warpqem.simplify(*mesh, ratio=0.2, device="cpu"))
    one, three = results
    np.testing.assert_array_equal(one.faces, three.faces)
    np.testing.assert_array_equal(one.points, three.points)
    np.testing.assert_array_equal(one.log.removed, three.log.removed)


def lists_of(adjacency, vertex_count):
    start, end, corner = (a.numpy() for a in (adjacency.start, adjacency.end, adjacency.corner))
    return [corner[start[v] : end[v]].tolist() for v in range(vertex_count)]


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("spare", [0, 300, 10**5], ids=["no room", "some room", "room"])
def test_adjacency_is_that_of_the_faces_after_every_pass(
    spare, threads, device, monkeypatch, shared_from_the_first_face
):
    if wp.get_device(device).is_cpu:
        monkeypatch.setattr("warpqem.decimation.pass_steps.thread_count", lambda _: threads)
    points, faces = meshes.waving_grid(24, 3)
    mesh = build_mesh(points, faces, device, spare=spare)
    vertex_count = points.shape[1]
    orderer = Orderer(PassSteps(mesh.state, mesh.frames, mesh.adjacency, cost_model(key_count=3), device))
    orderer.steps.compute_all_costs()
    for _ in range(12):
        orderer._run_pass(200, CANDIDATE_FRACTION)
        fresh = build_adjacency(mesh.state.corner_vertex, vertex_count, mesh.state.face_count)
        assert lists_of(mesh.state.adjacency, vertex_count) == lists_of(fresh.lists, vertex_count)


def test_no_caller_changes_the_share_of_work_that_others_get():
    work = part_work(0, 2, "cpu")
    with pytest.raises(AttributeError, match="thread_count of a share"):
        work.thread_count = work.thread_count + 999
    later = part_work(0, 2, "cpu")
    assert (later.part, later.part_count, later.thread_count) == (0, 2, work.thread_count)
    assert (later._ctype.part, later._ctype.part_count, later._ctype.thread_count) == (0, 2, work.thread_count)
    assert later.thread_count < 999
