"""The independent set of collapses of one round: cap, candidates, claim.

An edge wins when its 64-bit key (cost bits, then a shuffled index) is the smallest at every vertex of its closed
neighbourhood. Then no vertex of a winner is a neighbour of another winner's, so no two winners share a face; they may
share a ring vertex, whose fan loses a face to each but keeps those between them. So the batch equals the same collapses
made one after another in any order.
"""

import warp as wp

from warpqem.kernels.mesh_state import MeshState
from warpqem.kernels.topology import half_edge_target

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# Costs are binned by the upper bits of their float: 8 of exponent and 4 of mantissa, so a bin is 6 % wide at most.
BIN_SHIFT = wp.constant(wp.int32(19))
UNCLAIMED = wp.constant(wp.int64(0x7FFFFFFFFFFFFFFF))


@wp.struct
class EdgeList:
    """Half-edges on the device, their number too."""

    count: wp.array[wp.int32]  # (1,)
    half_edge: wp.array[wp.int32]


@wp.func
def is_candidate_cost(cost: wp.float32) -> wp.bool:
    """Awake (not negative) and allowed (not infinite)."""
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
    x = (x ^ (x >> wp.uint32(16))) * wp.uint32(0x85EBCA6B)
    x = (x ^ (x >> wp.uint32(13))) * wp.uint32(0xC2B2AE35)
    return x ^ (x >> wp.uint32(16))


@wp.func
def claim_key(state: MeshState, h: wp.int32) -> wp.int64:
    """``cost bits << 32 | shuffled index``."""
    return (wp.int64(wp.cast(state.edge_cost[h], wp.int32)) << wp.int64(32)) | wp.int64(shuffled(h))


@wp.kernel
def count_costs(
    edge_cost_in: wp.array[wp.float32],
    half_edge_count: wp.int32,
    sample_step: wp.int32,
    stride: wp.int32,
    # outputs
    histogram_out: wp.array[wp.int32],
):
    """Histogram of the costs of the candidate edges at every ``sample_step``-th half-edge."""
    for h in range(wp.tid() * sample_step, half_edge_count, stride * sample_step):
        cost = edge_cost_in[h]
        if is_candidate_cost(cost):
            wp.atomic_add(histogram_out, cost_bin(cost), 1)


@wp.kernel
def find_cap(
    wanted: wp.int32,
    # outputs
    histogram: wp.array[wp.int32],
    cap_out: wp.array[wp.int32],
):
    """The bin of the ``wanted``-th cheapest edge; the histogram is cleared for the next pass."""
    seen = wp.int32(0)
    cap = wp.int32(-1)
    for b in range(histogram.shape[0]):
        n = histogram[b]
        histogram[b] = 0
        if n > 0 and seen < wanted:
            cap = b
        seen += n
    cap_out[0] = cap


@wp.kernel
def collect_candidates(
    edge_cost_in: wp.array[wp.float32],
    half_edge_count: wp.int32,
    cap_in: wp.array[wp.int32],
    stride: wp.int32,
    # outputs
    candidates: EdgeList,
):
    """Half-edges with a cost up to the cap (count zeroed before the launch)."""
    for h in range(wp.tid(), half_edge_count, stride):
        cost = edge_cost_in[h]
        if is_candidate_cost(cost) and cost_bin(cost) <= cap_in[0]:
            candidates.half_edge[wp.atomic_add(candidates.count, 0, 1)] = h


@wp.kernel
def claim_vertices(
    state: MeshState,
    candidates: EdgeList,
    stride: wp.int32,
    # outputs
    claim: wp.array[wp.int64],
):
    """Each candidate claims its two ends; the smallest key stays."""
    for i in range(wp.tid(), candidates.count[0], stride):
        h = candidates.half_edge[i]
        key = claim_key(state, h)
        wp.atomic_min(claim, state.corner_vertex[h], key)
        wp.atomic_min(claim, half_edge_target(state.corner_vertex, h), key)


@wp.func
def holds_star(state: MeshState, claim: wp.array[wp.int64], v: wp.int32, key: wp.int64) -> wp.bool:
    """Whether no vertex of the star of ``v`` is claimed by a smaller key."""
    i = state.star_start[v]
    last = state.star_start[v + 1]
    holds = claim[v] == key
    while holds and i < last:
        f = state.star_corner[i] // 3
        for k in range(3):
            w = state.corner_vertex[3 * f + k]
            if claim[w] < key:
                holds = False
        i += 1
    return holds


@wp.kernel
def select_winners(
    state: MeshState,
    candidates: EdgeList,
    claim_in: wp.array[wp.int64],
    stride: wp.int32,
    # outputs
    winners: EdgeList,
):
    """Candidates whose key is the smallest at every vertex of both ends' stars (count zeroed before the launch)."""
    for i in range(wp.tid(), candidates.count[0], stride):
        h = candidates.half_edge[i]
        key = claim_key(state, h)
        if holds_star(state, claim_in, state.corner_vertex[h], key) and holds_star(
            state, claim_in, half_edge_target(state.corner_vertex, h), key
        ):
            winners.half_edge[wp.atomic_add(winners.count, 0, 1)] = h


@wp.kernel
def withdraw_claims(
    state: MeshState,
    candidates: EdgeList,
    stride: wp.int32,
    # outputs
    claim_out: wp.array[wp.int64],
):
    """Leave every vertex unclaimed for the next round."""
    for i in range(wp.tid(), candidates.count[0], stride):
        h = candidates.half_edge[i]
        claim_out[state.corner_vertex[h]] = UNCLAIMED
        claim_out[half_edge_target(state.corner_vertex, h)] = UNCLAIMED


@wp.kernel
def shrink_candidates(
    state: MeshState,
    mask_in: wp.array[wp.int32],
    pass_number_in: wp.array[wp.int32],
    candidates_in: EdgeList,
    stride: wp.int32,
    # outputs
    candidates_out: EdgeList,
):
    """Keep the candidates that are alive, awake and outside the neighbourhoods of this pass's winners.

    A winner's one-ring is masked whole, so the stars of what is kept are as they were when the pass began.
    """
    for i in range(wp.tid(), candidates_in.count[0], stride):
        h = candidates_in.half_edge[i]
        u = state.corner_vertex[h]
        if u >= 0 and is_candidate_cost(state.edge_cost[h]):
            v = half_edge_target(state.corner_vertex, h)
            if mask_in[u] != pass_number_in[0] and mask_in[v] != pass_number_in[0]:
                candidates_out.half_edge[wp.atomic_add(candidates_out.count, 0, 1)] = h
