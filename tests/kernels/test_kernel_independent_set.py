"""Threshold, candidates, reservations and selected edges of a round."""

import numpy as np
import pytest
import warp as wp

from tests.oracles import topology as oracle
from tests.support import meshes
from tests.support.mesh_state import build_mesh, cost_model, edge_list, listed, one_part, state_of_costs
from warpqem.decimation.recorded_launches import new_edge_list
from warpqem.kernels import independent_set as kernels
from warpqem.kernels.edge_cost import compute_all_costs
from warpqem.kernels.lanes import width_of

wp.set_module_options({"enable_backward": False})  # no gradients are taken

BINS = 4096
MESHES = {"closed": meshes.swaying_sphere(2, 2), "open": meshes.bending_bar(8, 12, 3)}


def no_threshold(device) -> wp.array:
    """A threshold above any cost."""
    return wp.array([np.inf], dtype=wp.float32, device=device)


@wp.kernel
def shuffle_indices(
    # in
    index_in: wp.array[wp.int32],
    # out
    shuffled_out: wp.array[wp.uint32],
):
    shuffled_out[wp.tid()] = kernels.shuffled(index_in[wp.tid()])


@wp.kernel
def bin_costs(
    # in
    cost_in: wp.array[wp.float32],
    # out
    bin_out: wp.array[wp.int32],
):
    bin_out[wp.tid()] = kernels.cost_bin(cost_in[wp.tid()])


def bins_of(cost, device) -> np.ndarray:
    out = wp.empty(len(cost), dtype=wp.int32, device=device)
    cost = wp.array(cost, dtype=wp.float32, device=device)
    wp.launch(bin_costs, dim=len(cost), inputs=[cost], outputs=[out], device=device)
    return out.numpy()


def step_of(step, device) -> wp.array:
    return wp.array([step], dtype=wp.int32, device=device)


def histogram_of(cost, device, step=1, part_count=1) -> wp.array:
    """(P, BINS)."""
    histogram = wp.zeros((part_count, BINS), dtype=wp.int32, device=device)
    for part in range(part_count):
        inputs = [state_of_costs(cost, device), step_of(step, device), one_part(device, part, part_count)]
        wp.launch(kernels.count_costs, dim=1, inputs=inputs, outputs=[histogram], device=device)
    return histogram


def test_sampled_histogram_counts_every_seventh_cost(device):
    cost = np.geomspace(1e-9, 1.0, 100).astype(np.float32)
    every_seventh = histogram_of(cost[::7], device).numpy()
    np.testing.assert_array_equal(histogram_of(cost, device, step=7).numpy(), every_seventh)


@pytest.mark.parametrize("step", [1, 7])
def test_histograms_of_three_parts_give_the_threshold_of_one(step, device):
    cost = random_costs()
    one, three = (histogram_of(cost, device, step, parts) for parts in (1, 3))
    np.testing.assert_array_equal(three.numpy().sum(axis=0), one.numpy()[0])
    assert find_threshold(three, 50, device).numpy()[0] == find_threshold(one, 50, device).numpy()[0]
    assert not three.numpy().any()


def find_threshold(histogram, wanted, device, others=0) -> wp.array:
    """The threshold where so many ``others`` cost more than what the histogram has counted."""
    counts = histogram.numpy()
    counts[0, bins_of(np.array([1e30]), device)[0]] += others
    histogram.assign(counts)
    cost_threshold = wp.zeros(1, dtype=wp.float32, device=device)
    wanted = wp.array([wanted], dtype=wp.int32, device=device)
    wp.launch(
        kernels.find_cost_threshold,
        dim=1,
        inputs=[wanted, step_of(1, device)],
        outputs=[histogram, cost_threshold],
        device=device,
    )
    return cost_threshold


def find_by_sums(histogram, stretches, wanted, step, device) -> wp.array:
    sums, cheapest, edge_count = (wp.empty(count, dtype=wp.int32, device=device) for count in (stretches, 1, 1))
    cost_threshold = wp.full(1, 7.0, dtype=wp.float32, device=device)
    wp.launch(kernels.sum_bins, dim=stretches, inputs=[histogram], outputs=[sums], device=device)
    outputs = [histogram, cost_threshold, cheapest, edge_count]
    wp.launch(
        kernels.find_threshold_by_sums, dim=stretches, inputs=[wanted, step, sums], outputs=outputs, device=device
    )
    wp.launch(kernels.bound_threshold, dim=1, inputs=[edge_count, cheapest], outputs=[cost_threshold], device=device)
    return cost_threshold


@pytest.mark.parametrize("stretches", [1, 64, 4096])
@pytest.mark.parametrize("wanted", [0, 1, 2, 20, 32, 50, 999, 1000, 5000])
@pytest.mark.parametrize("step", [1, 7])
@pytest.mark.parametrize("spread", [1.0, 1e6])
def test_threshold_by_sums_is_that_of_one_thread(stretches, wanted, step, spread, device):
    costs = random_costs()
    costs[::2] *= np.float32(spread)
    histogram, other = (histogram_of(costs, device, step) for _ in range(2))
    inputs = [wp.array([wanted], dtype=wp.int32, device=device), step_of(step, device)]
    cost_threshold = find_by_sums(histogram, stretches, *inputs, device)
    one = wp.zeros(1, dtype=wp.float32, device=device)
    wp.launch(kernels.find_cost_threshold, dim=1, inputs=inputs, outputs=[other, one], device=device)
    assert cost_threshold.numpy()[0] == one.numpy()[0]
    assert not histogram.numpy().any()


def test_threshold_by_sums_of_no_costs_is_zero(device):
    histogram = wp.zeros((1, BINS), dtype=wp.int32, device=device)
    wanted = wp.array([5], dtype=wp.int32, device=device)
    assert find_by_sums(histogram, 64, wanted, step_of(1, device), device).numpy()[0] == 0.0


@pytest.mark.parametrize(("wanted", "taken"), [(20, 5), (32, 5), (33, 33)])
def test_on_a_small_mesh_costly_edges_wait_until_the_cheap_ones_are_gone(wanted, taken, device):
    cost = np.concatenate([np.linspace(1e-6, 5e-4, 5), np.linspace(1.0, 2.0, 60)]).astype(np.float32)
    cost_threshold = find_threshold(histogram_of(cost, device), wanted, device, others=300).numpy()[0]
    assert taken <= (cost < cost_threshold).sum() <= taken + 5


def collected(cost, cost_threshold, device) -> np.ndarray:
    candidates = edge_list([], device, len(cost))
    inputs = [state_of_costs(cost, device), cost_threshold, one_part(device)]
    wp.launch(kernels.collect_candidates, dim=1, inputs=inputs, outputs=[candidates], device=device)
    return np.sort(listed(candidates))


def random_costs(count=1000) -> np.ndarray:
    return np.random.default_rng(0).lognormal(-10, 3, count).astype(np.float32)


def test_shuffled_indices_are_distinct(device):
    out = wp.empty(100000, dtype=wp.uint32, device=device)
    index = wp.array(np.arange(100000), dtype=wp.int32, device=device)
    wp.launch(shuffle_indices, dim=100000, inputs=[index], outputs=[out], device=device)
    assert len(np.unique(out.numpy())) == 100000


def test_shuffled_indices_do_not_favour_low_ones(device):
    out = wp.empty(10000, dtype=wp.uint32, device=device)
    index = wp.array(np.arange(10000), dtype=wp.int32, device=device)
    wp.launch(shuffle_indices, dim=10000, inputs=[index], outputs=[out], device=device)
    assert abs(np.corrcoef(np.arange(10000), out.numpy().astype(float))[0, 1]) < 0.05


def test_bins_keep_the_order_of_costs(device):
    bins = bins_of(np.sort(random_costs()), device)
    assert (np.diff(bins) >= 0).all()
    assert bins.min() >= 0
    assert bins.max() < BINS


def test_largest_finite_cost_has_a_bin(device):
    assert 0 <= bins_of(np.array([np.finfo(np.float32).max]), device)[0] < BINS


def test_costs_of_one_bin_differ_by_one_sixteenth_at_most(device):
    cost = random_costs()
    bins = bins_of(cost, device)
    assert max(cost[bins == b].max() / cost[bins == b].min() for b in np.unique(bins)) <= 1 + 1 / 16


def test_histogram_counts_every_candidate_in_its_bin(device):
    cost = random_costs()
    expected = np.bincount(bins_of(cost, device), minlength=BINS)
    np.testing.assert_array_equal(histogram_of(cost, device).numpy()[0], expected)


def test_histogram_leaves_out_suspended_and_forbidden_edges(device):
    assert histogram_of(np.array([1, -1, np.inf, -np.inf, 2, np.nan], np.float32), device).numpy().sum() == 2


@pytest.mark.parametrize("wanted", [1, 2, 50, 999, 1000])
def test_threshold_is_the_upper_end_of_the_bin_of_the_wanted_cheapest_edge(wanted, device):
    cost = random_costs()
    cost_threshold = find_threshold(histogram_of(cost, device), wanted, device, others=8000).numpy()
    assert bins_of(cost_threshold, device)[0] == bins_of(np.sort(cost), device)[wanted - 1] + 1
    assert bins_of(np.nextafter(cost_threshold, np.float32(0)), device)[0] == bins_of(np.sort(cost), device)[wanted - 1]


def test_threshold_takes_everything_where_few_edges_exist(device):
    cost = np.geomspace(0.5, 1.0, int(kernels.MIN_CANDIDATES)).astype(np.float32)
    cost_threshold = find_threshold(histogram_of(cost, device), 1000, device)
    assert len(collected(cost, cost_threshold, device)) == len(cost)


def test_threshold_of_no_edge_lets_none_through(device):
    cost_threshold = find_threshold(histogram_of(np.array([np.inf], np.float32), device), 5, device)
    assert len(collected(random_costs(5), cost_threshold, device)) == 0


def test_histogram_is_clear_after_the_threshold_is_found(device):
    histogram = histogram_of(random_costs(), device)
    find_threshold(histogram, 10, device)
    np.testing.assert_array_equal(histogram.numpy(), 0)


def test_candidates_are_the_edges_up_to_the_threshold(device):
    cost = random_costs()
    cost[::7] *= -1
    cost[::11] = np.inf
    cost_threshold = find_threshold(histogram_of(cost, device), 90, device)
    expected = np.flatnonzero((cost > 0) & (cost < cost_threshold.numpy()[0]))
    assert len(expected) >= 90
    np.testing.assert_array_equal(collected(cost, cost_threshold, device), expected)


def round_of(state, half_edges, reservation, device) -> np.ndarray:
    """The edges that one round selects among the half-edges."""
    candidates, selected = edge_list(half_edges, device), edge_list([], device, len(half_edges))
    work = one_part(device)
    wp.launch(kernels.reserve_vertices, dim=1, inputs=[state, candidates, work], outputs=[reservation], device=device)
    wp.launch(
        kernels.select_collapses,
        dim=1,
        inputs=[state, candidates, reservation, work],
        outputs=[selected],
        device=device,
    )
    wp.launch(kernels.clear_reservations, dim=1, inputs=[state, candidates, work], outputs=[reservation], device=device)
    return listed(selected)


@pytest.fixture(scope="module", params=MESHES)
def with_costs(request, device):
    """(state, faces, candidate half-edges, reservations) of a mesh with the costs of all its edges."""
    points, faces = MESHES[request.param]
    mesh = build_mesh(points, faces, device)
    state = mesh.state
    compute = compute_all_costs[width_of(mesh.frames.position)]
    wp.launch(compute, dim=1, inputs=[state, mesh.frames, cost_model(), one_part(device)], device=device)
    candidates = np.flatnonzero(np.isfinite(state.edge_cost.numpy()))
    reservation = wp.full(points.shape[1], kernels.UNRESERVED, dtype=wp.int64, device=device)
    return state, faces, candidates, reservation


def ends_of(faces, h) -> set[int]:
    return {int(faces.ravel()[h]), int(np.roll(faces, -1, axis=1).ravel()[h])}


def test_no_selected_edge_has_an_end_in_the_one_ring_of_another(with_costs, device):
    state, faces, candidates, reservation = with_costs
    selected = round_of(state, candidates, reservation, device)
    assert len(selected) > 1
    ends = [ends_of(faces, h) for h in selected]
    for i, mine in enumerate(ends):
        near = oracle.closed_neighbourhood(faces, mine)
        assert all(near.isdisjoint(other) for j, other in enumerate(ends) if j != i)


def test_cheapest_edge_always_wins(with_costs, device):
    state, _, candidates, reservation = with_costs
    cost = state.edge_cost.numpy()[candidates]
    assert candidates[cost.argmin()] in round_of(state, candidates, reservation, device)


def test_every_selected_edge_is_the_cheapest_of_its_neighbourhood(with_costs, device):
    state, faces, candidates, reservation = with_costs
    cost = state.edge_cost.numpy()
    ends = {int(h): ends_of(faces, h) for h in candidates}
    for h in round_of(state, candidates, reservation, device):
        near = oracle.closed_neighbourhood(faces, ends[int(h)])
        assert cost[h] <= min(cost[g] for g in ends if not near.isdisjoint(ends[g]))


def test_selected_edges_do_not_depend_on_the_order_of_candidates(with_costs, device):
    state, _, candidates, reservation = with_costs
    shuffled = np.random.default_rng(1).permutation(candidates)
    first, second = (np.sort(round_of(state, c, reservation, device)) for c in (candidates, shuffled))
    np.testing.assert_array_equal(first, second)


def test_reservations_are_cleared(with_costs, device):
    state, _, candidates, reservation = with_costs
    round_of(state, candidates, reservation, device)
    assert (reservation.numpy() == int(kernels.UNRESERVED)).all()


def test_selected_edges_of_all_rounds_are_a_maximal_independent_set(with_costs, device):
    state, faces, candidates, reservation = with_costs
    number = wp.array([1], dtype=wp.int32, device=device)
    taken, left = [], candidates
    masked = np.zeros(len(reservation), dtype=np.int32)
    while len(left):
        selected = round_of(state, left, reservation, device)
        assert len(selected)
        taken += selected.tolist()
        for h in selected:
            masked[list(oracle.closed_neighbourhood(faces, ends_of(faces, h)))] = 1
        rest = edge_list([], device, len(left))
        mask = wp.array(masked, dtype=wp.int32, device=device)
        inputs = [state, mask, number, no_threshold(device), edge_list(left, device), one_part(device)]
        wp.launch(kernels.shrink_candidates, dim=1, inputs=inputs, outputs=[rest], device=device)
        left = listed(rest)
    ends = [ends_of(faces, h) for h in taken]
    near = [oracle.closed_neighbourhood(faces, e) for e in ends]
    assert all(near[i].isdisjoint(ends[j]) for i in range(len(ends)) for j in range(len(ends)) if i != j)
    assert all(any(not n.isdisjoint(ends_of(faces, h)) for n in near) for h in candidates)


def test_shrinking_drops_dead_and_suspended_candidates(device):
    points, faces = MESHES["closed"]
    dead, suspended, kept = 0, 30, 60
    faces = faces.copy()
    faces[0] = -1
    state = build_mesh(points, np.maximum(faces, 0), device).state
    state.corner_vertex.assign(faces.ravel())
    cost = np.ones(faces.size, dtype=np.float32)
    cost[suspended] = -1
    state.edge_cost.assign(cost)
    rest = edge_list([], device, 3)
    mask = wp.zeros(points.shape[1], dtype=wp.int32, device=device)
    number = wp.array([1], dtype=wp.int32, device=device)
    inputs = [state, mask, number, no_threshold(device), edge_list([dead, suspended, kept], device), one_part(device)]
    wp.launch(kernels.shrink_candidates, dim=1, inputs=inputs, outputs=[rest], device=device)
    assert listed(rest).tolist() == [kept]


def test_shrinking_drops_candidates_that_were_found_costlier_than_the_threshold(device):
    points, faces = MESHES["closed"]
    state = build_mesh(points, faces, device).state
    cost = np.ones(faces.size, dtype=np.float32)
    cost[30] = 2.0
    state.edge_cost.assign(cost)
    rest = edge_list([], device, 2)
    mask = wp.zeros(points.shape[1], dtype=wp.int32, device=device)
    number, cost_threshold = (
        wp.array([1], dtype=wp.int32, device=device),
        wp.array([1.5], dtype=wp.float32, device=device),
    )
    inputs = [state, mask, number, cost_threshold, edge_list([30, 60], device), one_part(device)]
    wp.launch(kernels.shrink_candidates, dim=1, inputs=inputs, outputs=[rest], device=device)
    assert listed(rest).tolist() == [60]


def test_parts_together_find_the_selected_edges_of_one(with_costs, device):
    state, _, candidates, reservation = with_costs
    alone = round_of(state, candidates, reservation, device)
    two = wp.array(candidates, dtype=wp.int32, device=device)
    shared, selected = new_edge_list(two, 2), new_edge_list(wp.empty_like(two), 2)
    shared.count.assign([shared.capacity, shared.capacity])
    parts = [one_part(device, part, 2) for part in range(2)]
    for work in parts:
        wp.launch(kernels.reserve_vertices, dim=1, inputs=[state, shared, work], outputs=[reservation], device=device)
    for work in parts:
        wp.launch(
            kernels.select_collapses,
            dim=1,
            inputs=[state, shared, reservation, work],
            outputs=[selected],
            device=device,
        )
    for work in parts:
        wp.launch(kernels.clear_reservations, dim=1, inputs=[state, shared, work], outputs=[reservation], device=device)
    taken = selected.half_edge.numpy().reshape(2, -1)
    found = [taken[part][:count] for part, count in enumerate(selected.count.numpy())]
    last = len(candidates) // 2 * 2
    expected = alone if last == len(candidates) else round_of(state, candidates[:last], reservation, device)
    np.testing.assert_array_equal(np.concatenate(found), expected)


@pytest.mark.parametrize("step", [1, 7])
@pytest.mark.parametrize(("wanted", "share"), [(40, 0.02), (5000, 1 / 8)])
def test_a_pass_looks_at_an_eighth_of_the_edges_that_may_be_legal_at_most(step, wanted, share, device):
    costs = np.geomspace(1e-3, 1.0, 2000).astype(np.float32)
    # What is suspended or forbidden is no choice.
    all_costs = np.concatenate([costs, -costs, np.full(3000, np.inf, dtype=np.float32)])
    histogram = histogram_of(np.random.default_rng(3).permutation(all_costs), device, step)
    inputs = [wp.array([wanted], dtype=wp.int32, device=device), step_of(step, device)]
    threshold = wp.zeros(1, dtype=wp.float32, device=device)
    wp.launch(kernels.find_cost_threshold, dim=1, inputs=inputs, outputs=[histogram, threshold], device=device)
    # A bin is 6 % wide, which is 17 of these edges; a sample of 286 is 40 off.
    assert (costs < threshold.numpy()[0]).sum() == pytest.approx(share * len(costs), abs=20 if step == 1 else 80)
