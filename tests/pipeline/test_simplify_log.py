"""Progress, the log of collapses, and targets out of reach."""

import numpy as np
import pytest

import warpqem
from tests.oracles.topology import collapsed
from tests.support import meshes
from tests.support.moving_meshes import BAR, CLOTH, MESHES, SPHERE
from warpqem.errors import UnreachableTargetError
from warpqem.measure import topology


@pytest.mark.parametrize("target", [4, 300, 1278, 1279])
def test_progress_rises_to_one(target, device):
    seen = []
    warpqem.simplify(*SPHERE, target_faces=target, device=device, progress=lambda *call: seen.append(call))
    parts = [part for part, _ in seen]
    assert parts == sorted(parts)
    assert parts[0] >= 0
    assert parts[-1] == pytest.approx(1)
    assert max(parts) <= 1
    assert list(dict.fromkeys(stage for _, stage in seen)) == ["read", "order", "place"]


def test_log_sums_up_to_the_faces_removed(device):
    points, faces = CLOTH
    result = warpqem.simplify(points, faces, ratio=0.3, device=device)
    assert len(faces) - result.log.faces_removed.sum() == len(result.faces)
    assert set(result.log.faces_removed) == {1, 2}


def test_log_names_every_removed_vertex_once(device):
    points, faces = BAR
    log = warpqem.simplify(points, faces, ratio=0.3, device=device).log
    assert len(np.unique(log.removed)) == len(log) == points.shape[1] - len(np.unique(log.roots(points.shape[1])))


def test_log_holds_finite_costs_and_errors(device):
    result = warpqem.simplify(*BAR, ratio=0.3, device=device)
    assert np.isfinite(result.log.cost).all()
    assert (result.log.cost > 0).all()
    assert 100 * result.log.error.max() == pytest.approx(result.error)


def test_log_is_ordered_by_pass_then_cost(device):
    log = warpqem.simplify(*BAR, ratio=0.3, device=device).log
    assert log.round_index[0] == 1
    order = np.lexsort((log.cost, log.round_index))
    np.testing.assert_array_equal(log.cost[order], log.cost)
    np.testing.assert_array_equal(np.sort(log.round_index), log.round_index)


def test_replayed_log_gives_the_result(device):
    points, faces = CLOTH
    result = warpqem.simplify(points, faces, ratio=0.2, device=device)
    replayed = faces
    for kept, removed in zip(result.log.kept, result.log.removed, strict=True):
        replayed = collapsed(replayed, kept, removed)
    np.testing.assert_array_equal(result.vertex_map[replayed], result.faces)


@pytest.mark.parametrize("name", ["bar", "torus"])
def test_every_prefix_of_the_log_is_a_valid_mesh(name, device):
    points, faces = MESHES[name]
    log = warpqem.simplify(points, faces, ratio=0.1, device=device).log
    before, live = topology(faces), faces
    for i, (kept, removed) in enumerate(zip(log.kept, log.removed, strict=True)):
        after = collapsed(live, kept, removed)
        assert len(live) - len(after) == log.faces_removed[i]
        live = after
        if i % 20 == 0 or i == len(log) - 1:
            state = topology(live)
            assert (state.euler_number, state.components) == (before.euler_number, before.components)
            assert state.non_manifold_edges == state.non_manifold_vertices == state.repeated_faces == 0


def test_opposites_of_the_log_are_opposite_the_edge(device):
    points, faces = CLOTH
    live = faces
    # Where collapses are exchanged they are those that the order found.
    log = warpqem.simplify(points, faces, ratio=0.5, quality="fast", device=device).log
    for kept, removed, opposites in zip(log.kept, log.removed, log.opposites, strict=True):
        at_edge = live[(live == kept).any(axis=1) & (live == removed).any(axis=1)]
        assert set(at_edge.ravel()) - {kept, removed} == set(opposites) - {-1}
        live = collapsed(live, kept, removed)


def test_unreachable_target_holds_the_mesh_so_far(device):
    points, faces = meshes.bumpy_sphere(2)
    with pytest.raises(UnreachableTargetError, match=r"4 faces .* 2 were asked for") as caught:
        warpqem.simplify(points, faces, target_faces=2, device=device)
    assert len(caught.value.result.faces) == 4
    assert caught.value.result.stopped == "no legal collapse"


def test_edges_are_all_tried_before_giving_up(device):
    # Between old vertices no edge may collapse (its wings have three faces each) and every such edge is cheaper than
    # those to the new ones, which may.
    points, faces = meshes.split_faces(meshes.icosphere(2))
    new = np.arange(len(points)) >= len(meshes.icosphere(2)[0])
    weights = np.where(new, 1e6, 1.0)
    result = warpqem.simplify(points, faces, ratio=0.9, vertex_weights=weights, device=device)
    assert len(result.faces) == round(0.9 * len(faces))


@pytest.mark.parametrize("count", [10, 42, 162])
def test_every_free_vertex_of_a_large_mesh_is_found(count, device):
    # More half-edges than the threshold looks at one by one, and few of them at vertices that may move: the first of a
    # subdivided sphere, far apart from each other.
    points, faces = meshes.icosphere(5)
    locked = np.arange(len(points)) >= count
    result = warpqem.simplify(points, faces, target_faces=len(faces) - 2 * count, locked=locked, device=device)
    assert len(result.faces) == len(faces) - 2 * count


@pytest.mark.parametrize("name", ["bar", "torus"])
def test_log_of_more_faces_is_a_beginning_of_the_log_of_fewer(name, device):
    points, faces = MESHES[name]
    full = warpqem.simplify(points, faces, ratio=0.05, quality="fast", device=device).log
    for ratio in (0.8, 0.31, 0.3, 0.1):
        part = warpqem.simplify(points, faces, ratio=ratio, quality="fast", device=device).log
        for field in ("kept", "removed", "opposites", "cost", "error", "round_index", "recent_error"):
            np.testing.assert_array_equal(getattr(part, field), getattr(full, field)[: len(part)], err_msg=field)


@pytest.mark.parametrize("name", MESHES)
def test_recent_error_is_that_of_the_last_sixteenth_of_the_collapses(name, device):
    log = warpqem.simplify(*MESHES[name], ratio=0.2, device=device).log
    square = log.error.astype(np.float64) ** 2
    expected = [np.sqrt(square[max(i - max(i // 16, 1), 0) : i].mean()) for i in range(1, len(log) + 1)]
    np.testing.assert_allclose(log.recent_error, expected, rtol=1e-4, atol=1e-9)
