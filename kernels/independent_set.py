"""The independent set of collapses of one round: cost threshold, candidates, reservation of vertices.

An edge is selected when its 64-bit key (cost bits, then a shuffled index) is the smallest at every vertex of its closed
neighbourhood. Then no vertex of a selected edge is a neighbour of another selected edge's, so no two share a face; they
may share a ring vertex, whose fan loses a face to each but keeps those between them. So the batch equals the same
collapses made one after another in any order.
"""

import warp as wp

from warpqem.kernels.mesh_state import MeshState
from warpqem.kernels.pass_control import MIN_CANDIDATES
from warpqem.kernels.prefetch import prefetch_edges
from warpqem.kernels.topology import OPEN, half_edge_target, previous_corner
from warpqem.kernels.work import EdgeList, Work, append, first_item, last_item

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# Costs are binned by the upper bits of their float: 8 of exponent and 4 of mantissa, so a bin is 6 % wide at most.
BIN_SHIFT = wp.constant(wp.int32(19))
# The bin of infinity.
INFINITE_BIN = wp.constant(wp.int32(0x7F800000 >> 19))
# On a small mesh, of whose edges a pass looks at a large part, those count whose bins are within ten octaves of that of
# the cheapest: a collapse that costs nothing goes before one that takes a corner, and others go as they would.
SPREAD_BINS = wp.constant(wp.int32(160))
# A pass looks at no more than one in so many of the edges that may be legal, unless those are few. Where most edges are
# known to be illegal, as on lattices, a share of all edges is all of the others: parts without holes were collapsed to
# nothing in a few passes, whatever that cost. Thirteen small clips and four assemblies: without it RMS is 1.18 times as
# large, with 16 in place of 8 1.01 times.
EDGES_PER_CANDIDATE = wp.constant(wp.int32(8))
# The multipliers of murmur3's mixer.
FIRST_MIX = wp.constant(wp.uint32(0x85EBCA6B))
SECOND_MIX = wp.constant(wp.uint32(0xC2B2AE35))
UNRESERVED = wp.constant(wp.int64(0x7FFFFFFFFFFFFFFF))


@wp.func
def is_candidate_cost(cost: wp.float32) -> wp.bool:
    """Whether the cost is that of an edge neither suspended (negative) nor forbidden (infinite)."""
    return cost > 0.0 and cost < wp.inf


@wp.func
def cost_bin(cost: wp.float32) -> wp.int32:
    """Bin of a positive cost: the float's order is the order of its bits."""
    return wp.cast(cost, wp.int32) >> BIN_SHIFT


@wp.func
def shuffled(h: wp.int32) -> wp.uint32:
    """A well-mixed bijection of the half-edge's index (murmur3's mixer).

    Ties are broken without a preference for low indices, and since no two edges share a value, no two edges tie.
    """
    x = wp.uint32(h)
    x = (x ^ (x >> wp.uint32(16))) * FIRST_MIX
    x = (x ^ (x >> wp.uint32(13))) * SECOND_MIX
    return x ^ (x >> wp.uint32(16))


@wp.func
def reservation_key(state: MeshState, h: wp.int32) -> wp.int64:
    """``cost bits << 32 | shuffled index``."""
    return (wp.int64(wp.cast(state.edge_cost[h], wp.int32)) << wp.int64(32)) | wp.int64(shuffled(h))


@wp.kernel
def count_costs(
    # in
    state: MeshState,
    sample_step_in: wp.array[wp.int32],
    work: Work,
    # out
    histogram_out: wp.array2d[wp.int32],
):
    """Histogram of the costs of the candidate edges at every ``sample_step``-th half-edge, a row for each part."""
    sample_step = sample_step_in[0]
    sample_count = (3 * state.face_count[0] + sample_step - 1) // sample_step
    for i in range(first_item(sample_count, work) + wp.tid(), last_item(sample_count, work), work.thread_count):
        cost = state.edge_cost[i * sample_step]
        if is_candidate_cost(cost):
            wp.atomic_add(histogram_out, work.part, cost_bin(cost), 1)


@wp.func
def edges_to_look_at(wanted: wp.int32, sample_step: wp.int32, sampled: wp.int32) -> wp.int32:
    """How many edges a pass looks at that would like so many, where ``sampled`` of every step-th may be legal."""
    return wp.min(wanted, wp.max(MIN_CANDIDATES, sampled * sample_step // EDGES_PER_CANDIDATE))


@wp.func
def samples_of(edge_count: wp.int32, sample_step: wp.int32) -> wp.int32:
    """How many samples stand for so many edges; one at least for some."""
    return wp.max(wp.min(1, edge_count), edge_count // sample_step)


@wp.kernel
def find_cost_threshold(
    # in
    wanted_in: wp.array[wp.int32],
    sample_step_in: wp.array[wp.int32],
    # in and out
    histogram: wp.array2d[wp.int32],
    # out
    threshold_out: wp.array[wp.float32],
):
    """The upper end of the bin of the last edge to look at, of those in order of cost; 0 where none is wanted.

    Where few are looked at it is at most so much above the cheapest edge's, see ``SPREAD_BINS``. The histogram is
    cleared for the next pass.
    """
    total = wp.int32(0)
    for part in range(histogram.shape[0]):
        for b in range(histogram.shape[1]):
            total += histogram[part, b]
    edge_count = edges_to_look_at(wanted_in[0], sample_step_in[0], total)
    wanted = samples_of(edge_count, sample_step_in[0])
    seen = wp.int32(0)
    cost_threshold = wp.int32(-1)
    highest = wp.int32(histogram.shape[1])
    for b in range(histogram.shape[1]):
        n = wp.int32(0)
        for part in range(histogram.shape[0]):
            n += histogram[part, b]
            histogram[part, b] = 0
        if n > 0 and seen == 0 and edge_count <= MIN_CANDIDATES:
            highest = b + SPREAD_BINS
        if n > 0 and seen < wanted and b <= highest:
            cost_threshold = b
        seen += n
    threshold_out[0] = wp.cast((cost_threshold + 1) << BIN_SHIFT, wp.float32)


@wp.kernel
def sum_bins(
    # in
    histogram_in: wp.array2d[wp.int32],
    # out
    sum_out: wp.array[wp.int32],
):
    """Costs in each stretch of the bins of one part, as many stretches as ``sum_out`` has; a thread for each."""
    i = wp.tid()
    width = histogram_in.shape[1] // sum_out.shape[0]
    total = wp.int32(0)
    for b in range(i * width, (i + 1) * width):
        total += histogram_in[0, b]
    sum_out[i] = total


@wp.kernel
def find_threshold_by_sums(
    # in
    wanted_in: wp.array[wp.int32],
    sample_step_in: wp.array[wp.int32],
    sum_in: wp.array[wp.int32],
    # in and out
    histogram: wp.array2d[wp.int32],
    # out
    threshold_out: wp.array[wp.float32],
    cheapest_out: wp.array[wp.int32],
    edge_count_out: wp.array[wp.int32],
):
    """The threshold before it is bounded, by as many threads as there are sums, a stretch of bins each.

    The cheapest edges end in the bin where their number comes to what is wanted, or else in the last one with an edge:
    one thread has it. Another one has the bin of the cheapest edge, and the first one how many edges are looked at.
    """
    i = wp.tid()
    seen = wp.int32(0)
    total = wp.int32(0)
    for k in range(sum_in.shape[0]):
        if k < i:
            seen += sum_in[k]
        total += sum_in[k]
    edge_count = edges_to_look_at(wanted_in[0], sample_step_in[0], total)
    wanted = samples_of(edge_count, sample_step_in[0])
    if i == 0:
        edge_count_out[0] = edge_count
    if i == 0 and wp.min(wanted, total) == 0:
        threshold_out[0] = 0.0
    width = histogram.shape[1] // sum_in.shape[0]
    for b in range(i * width, (i + 1) * width):
        n = histogram[0, b]
        histogram[0, b] = 0
        if n > 0 and seen < wanted and (seen + n >= wanted or seen + n == total):
            threshold_out[0] = wp.cast((b + 1) << BIN_SHIFT, wp.float32)
        if n > 0 and seen == 0:
            cheapest_out[0] = b
        seen += n


@wp.kernel
def bound_threshold(
    # in
    edge_count_in: wp.array[wp.int32],
    cheapest_in: wp.array[wp.int32],
    # in and out
    threshold: wp.array[wp.float32],
):
    """Bound the threshold where few edges are looked at, after which it is that of :func:`find_cost_threshold`."""
    if edge_count_in[0] <= MIN_CANDIDATES and threshold[0] > 0.0:
        highest = wp.cast(wp.min(cheapest_in[0] + SPREAD_BINS + 1, INFINITE_BIN) << BIN_SHIFT, wp.float32)
        threshold[0] = wp.min(threshold[0], highest)


@wp.kernel
def collect_candidates(
    # in
    state: MeshState,
    threshold_in: wp.array[wp.float32],
    work: Work,
    # out
    candidates: EdgeList,
):
    """Half-edges with a cost below the threshold (counts zeroed before the launch)."""
    half_edge_count = 3 * state.face_count[0]
    last = last_item(half_edge_count, work)
    cost_threshold = threshold_in[0]
    h = first_item(half_edge_count, work) + wp.tid()
    while h < last:
        cost = state.edge_cost[h]
        if cost > 0.0 and cost < cost_threshold:
            append(candidates, work.part, h)
        h += work.thread_count


@wp.kernel
def reserve_vertices(
    # in
    state: MeshState,
    candidates: EdgeList,
    work: Work,
    # out
    reservation: wp.array[wp.int64],
):
    """The smallest key of the candidates that end at each vertex. A part walks all of them for its own vertices."""
    first_vertex = first_item(reservation.shape[0], work)
    last_vertex = last_item(reservation.shape[0], work)
    for part in range(work.part_count):
        for i in range(wp.tid(), candidates.count[part], work.thread_count):
            prefetch_edges(state, candidates, part, i, reservation, work)
            h = candidates.half_edge[part * candidates.capacity + i]
            u = state.corner_vertex[h]
            v = half_edge_target(state.corner_vertex, h)
            key = reservation_key(state, h)
            if u >= first_vertex and u < last_vertex:
                wp.atomic_min(reservation, u, key)
            if v >= first_vertex and v < last_vertex:
                wp.atomic_min(reservation, v, key)


@wp.func
def holds_ring(state: MeshState, reservation: wp.array[wp.int64], v: wp.int32, key: wp.int64) -> wp.bool:
    """Whether ``v`` is reserved by the key and no vertex of its one-ring by a smaller one."""
    i = state.adjacency.start[v]
    last = state.adjacency.end[v]
    holds = reservation[v] == key
    open_fan = (state.vertex_flags[v] & OPEN) != 0
    while holds and i < last:
        h = state.adjacency.corner[i]
        if reservation[half_edge_target(state.corner_vertex, h)] < key:
            holds = False
        if open_fan and reservation[state.corner_vertex[previous_corner(h)]] < key:
            holds = False
        i += 1
    return holds


@wp.kernel
def select_collapses(
    # in
    state: MeshState,
    candidates: EdgeList,
    reservation_in: wp.array[wp.int64],
    work: Work,
    # out
    selected: EdgeList,
):
    """Candidates whose key is the smallest in the one-rings of both ends (counts zeroed before the launch)."""
    for i in range(wp.tid(), candidates.count[work.part], work.thread_count):
        prefetch_edges(state, candidates, work.part, i, reservation_in, work)
        h = candidates.half_edge[work.part * candidates.capacity + i]
        u = state.corner_vertex[h]
        v = half_edge_target(state.corner_vertex, h)
        key = reservation_key(state, h)
        # Both ends first: most candidates fail there, without a walk around the one-rings.
        if (
            reservation_in[u] == key
            and reservation_in[v] == key
            and holds_ring(state, reservation_in, u, key)
            and holds_ring(state, reservation_in, v, key)
        ):
            append(selected, work.part, h)


@wp.kernel
def clear_reservations(
    # in
    state: MeshState,
    candidates: EdgeList,
    work: Work,
    # out
    reservation_out: wp.array[wp.int64],
):
    """Clear the reservation of every vertex for the next round."""
    for i in range(wp.tid(), candidates.count[work.part], work.thread_count):
        h = candidates.half_edge[work.part * candidates.capacity + i]
        reservation_out[state.corner_vertex[h]] = UNRESERVED
        reservation_out[half_edge_target(state.corner_vertex, h)] = UNRESERVED


@wp.kernel
def shrink_candidates(
    # in
    state: MeshState,
    mask_in: wp.array[wp.int32],
    pass_number_in: wp.array[wp.int32],
    threshold_in: wp.array[wp.float32],
    candidates_in: EdgeList,
    work: Work,
    # out
    candidates_out: EdgeList,
):
    """Candidates still alive, not suspended, below the threshold and outside the one-rings of this pass's collapses.

    The one-ring of a collapse is masked whole, so those of what is kept are as they were when the pass began.
    """
    for i in range(wp.tid(), candidates_in.count[work.part], work.thread_count):
        prefetch_edges(state, candidates_in, work.part, i, mask_in, work)
        h = candidates_in.half_edge[work.part * candidates_in.capacity + i]
        u = state.corner_vertex[h]
        # One whose check raised its cost is no candidate any more.
        if u >= 0 and is_candidate_cost(state.edge_cost[h]) and state.edge_cost[h] < threshold_in[0]:
            v = half_edge_target(state.corner_vertex, h)
            if mask_in[u] != pass_number_in[0] and mask_in[v] != pass_number_in[0]:
                append(candidates_out, work.part, h)
