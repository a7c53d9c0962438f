"""The loop of passes on a device: the collapses of the loop on the host, which does not close gaps either."""

import os
from dataclasses import replace

import numpy as np
import pytest
import warp as wp

import warpqem
import warpqem.runtime.device
from tests.support import cuda_semantics, meshes
from tests.support.mesh_state import build_mesh, cost_model
from warpqem.decimation import order_readback
from warpqem.decimation.adjacency import build_adjacency
from warpqem.decimation.device_loop import DeviceOrderer
from warpqem.decimation.order_readback import SPARE_ROOM, OrderReadback
from warpqem.decimation.pass_steps import PassSteps
from warpqem.decimation.passes import Orderer
from warpqem.errors import UnreachableTargetError

under_cuda_semantics = pytest.mark.skipif("CUDA_SEMANTICS" not in os.environ, reason="needs CUDA_SEMANTICS")

CLOSED, OPEN = meshes.swaying_sphere(3, 4), meshes.waving_grid(20, 4)
MANY_PARTS = meshes.joined(*[meshes.icosphere(0)] * 5, meshes.icosphere(2), *[meshes.tetrahedron()] * 4, spacing=2.5)
ENDS = {
    "50 %": {"ratio": 0.5},
    "30 %": {"ratio": 0.3},
    "10 %": {"ratio": 0.1},
    "3 %": {"ratio": 0.03},
    "unreachable": {"target_faces": 1, "max_error": 0.3},
    "no legal collapse": {"target_faces": 1},
    "error limit": {"max_error": 0.4},
}
KINDS = {
    "memoryless": {"memoryless": True},
    "dod": {"metric": "dod"},
    "aqem": {"metric": "aqem"},
    "one frame": {"metric": "qem"},
    "endpoint": {"placement": "endpoint"},
    "locked": {"lock_borders": True},
}


def on_host(steps):
    return Orderer(steps, compacts=False)


@pytest.fixture
def simplified(monkeypatch, device):
    """Simplify with a loop of one's own; the result, also of a target that cannot be reached."""

    def simplify(loop, mesh, **options):
        monkeypatch.setattr("warpqem.decimation.decimate._new_ordering", loop)
        try:
            return warpqem.simplify(*mesh, device=device, **options)
        except UnreachableTargetError as error:
            return error.result

    return simplify


@pytest.fixture
def queued_turns(monkeypatch, device):
    """A device whose graphs hold no loops."""
    name = "cpu" if wp.get_device(device).is_cpu else "cuda"
    monkeypatch.setitem(
        warpqem.runtime.device._TRAITS, name, replace(warpqem.runtime.device._TRAITS[name], graph_loops=False)
    )


def assert_same(one, other):
    assert one.stopped == other.stopped
    for name in ("points", "faces", "vertex_map", "face_map"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    for name in ("kept", "removed", "opposites", "faces_removed", "round_index"):
        np.testing.assert_array_equal(getattr(one.log, name), getattr(other.log, name))
    # The compiler of a GPU rounds the same sums otherwise in another kernel.
    rounding = 1e-5 if wp.is_cuda_available() else 0.0
    for name in ("cost", "error"):
        np.testing.assert_allclose(getattr(one.log, name), getattr(other.log, name), rtol=rounding, atol=0.0)


@pytest.mark.parametrize("mesh", [CLOSED, OPEN], ids=["closed", "open"])
@pytest.mark.parametrize("options", ENDS.values(), ids=ENDS)
def test_loop_ends_as_on_the_host(options, mesh, simplified):
    assert_same(simplified(DeviceOrderer, mesh, **options), simplified(on_host, mesh, **options))


@pytest.mark.parametrize("options", KINDS.values(), ids=KINDS)
def test_loop_makes_the_collapses_of_the_host(options, simplified):
    assert_same(*(simplified(loop, OPEN, ratio=0.2, **options) for loop in (DeviceOrderer, on_host)))


def test_loop_reads_a_sample_of_the_costs_where_the_host_does(simplified):
    large = meshes.swaying_sphere(4, 2)
    assert_same(*(simplified(loop, large, ratio=0.5) for loop in (DeviceOrderer, on_host)))


@pytest.mark.parametrize("options", ENDS.values(), ids=ENDS)
def test_queued_turns_end_as_on_the_host(options, simplified, queued_turns):
    assert_same(simplified(DeviceOrderer, CLOSED, **options), simplified(on_host, CLOSED, **options))


@pytest.mark.parametrize("target", [30, 12, 1])
def test_components_are_pruned_as_on_the_host(target, simplified):
    results = [simplified(loop, MANY_PARTS, target_faces=target) for loop in (DeviceOrderer, on_host)]
    assert_same(*results)
    assert results[0].components_removed == results[1].components_removed > 0


def test_components_are_pruned_between_queued_turns(simplified, queued_turns):
    assert_same(*(simplified(loop, MANY_PARTS, target_faces=12) for loop in (DeviceOrderer, on_host)))


@pytest.mark.parametrize("options", [{}, {"memoryless": True}], ids=["default", "memoryless"])
def test_levels_are_those_of_the_host(options, monkeypatch, device):
    levels = []
    for loop in (DeviceOrderer, on_host):
        monkeypatch.setattr("warpqem.decimation.decimate._new_ordering", loop)
        levels.append(warpqem.simplify_levels(*CLOSED, ratios=[0.5, 0.2, 0.05], device=device, **options))
    for one, other in zip(*levels, strict=True):
        np.testing.assert_array_equal(one.points, other.points)
        np.testing.assert_array_equal(one.faces, other.faces)


def test_progress_falls_to_the_target(simplified):
    told = []
    simplified(DeviceOrderer, CLOSED, ratio=0.1, progress=lambda share, _: told.append(share))
    assert told == sorted(told)
    assert len(told) > 5


def orderer_of(mesh, device, pool):
    points, faces = mesh
    mesh = build_mesh(points, faces, device, spare=int((pool - 1) * faces.size))
    model = cost_model(key_count=len(points))
    return mesh, DeviceOrderer(PassSteps(mesh.state, mesh.frames, mesh.adjacency, model, device))


@pytest.mark.parametrize("is_queued", [False, True], ids=["loop in the graph", "turns"])
def test_size_of_the_pool_changes_no_bit(is_queued, device, request):
    if is_queued:
        request.getfixturevalue("queued_turns")
    left = []
    for pool in (2, 2.5, 20):
        mesh, orderer = orderer_of(CLOSED, device, pool)
        assert orderer.run(100) == "target"
        corners = mesh.state.corner_vertex.numpy()
        fresh = build_adjacency(mesh.state.corner_vertex, len(mesh.position), mesh.state.face_count)
        lists = [
            [corner.numpy()[a:b].tolist() for a, b in zip(start.numpy(), end.numpy(), strict=True)]
            for start, end, corner in (
                (adjacency.start, adjacency.end, adjacency.corner) for adjacency in (mesh.state.adjacency, fresh.lists)
            )
        ]
        assert lists[0] == lists[1]
        left.append((corners, mesh.position, mesh.quadric))
    for corners, position, quadric in left[1:]:
        np.testing.assert_array_equal(corners, left[0][0])
        np.testing.assert_array_equal(position, left[0][1])
        np.testing.assert_array_equal(quadric, left[0][2])


def test_adjacency_is_built_anew_where_the_pool_is_full(device, monkeypatch):
    builds = []
    note = DeviceOrderer._building_adjacency
    mesh, orderer = orderer_of(CLOSED, device, 2)
    corner_count = len(mesh.state.corner_vertex)
    monkeypatch.setattr(DeviceOrderer, "_building_adjacency", lambda self: builds.append(1) or note(self))
    orderer.run(100)
    # Without that, what adjacency has taken would be beyond the pool.
    assert int(mesh.state.adjacency.used.numpy()[0]) <= 2 * corner_count
    with pytest.raises(ValueError, match=r"need a pool of"):
        orderer_of(CLOSED, device, 1.5)


@under_cuda_semantics
def test_ordering_waits_for_the_device_once(monkeypatch):
    traffic = []
    run = DeviceOrderer.run

    def counted(self, *args):
        with cuda_semantics.counted() as counts:
            reason = run(self, *args)
        traffic.append(counts)
        return reason

    reading = []
    read = OrderReadback.read

    def counted_read(self, *args):
        with cuda_semantics.counted() as counts:
            found = read(self, *args)
        reading.append(counts)
        return found

    monkeypatch.setattr(DeviceOrderer, "run", counted)
    monkeypatch.setattr(OrderReadback, "read", counted_read)
    result = warpqem.simplify(*CLOSED, ratio=0.1, quality="fast", device="cpu")
    (counts,) = traffic
    assert counts.readbacks == 1
    # Four numbers of the loop, and all of the log and the faces left: nothing more is asked for.
    log_and_faces = 7 * (len(result.log) + SPARE_ROOM) + 1 + len(result.faces) + SPARE_ROOM
    assert counts.values_read <= 4 + log_and_faces + 8
    assert counts.graph_launches == 1
    assert reading[0].readbacks == 0


@under_cuda_semantics
def test_a_log_longer_than_was_expected_is_read_after_the_loop(monkeypatch):
    expected = warpqem.simplify(*CLOSED, ratio=0.3, device="cpu")
    monkeypatch.setattr(order_readback, "SPARE_ROOM", -50)
    found = warpqem.simplify(*CLOSED, ratio=0.3, device="cpu")
    assert found.points.tobytes() == expected.points.tobytes()
    np.testing.assert_array_equal(found.faces, expected.faces)
    np.testing.assert_array_equal(found.log.removed, expected.log.removed)
