"""Which collapses are legal. A collapse ``u v -> u`` is refused when one of these rules is broken:

| rule            | why                                                                                              |
|-----------------|--------------------------------------------------------------------------------------------------|
| link condition  | a common neighbour not opposite the edge would leave two faces on three edges (non-manifold)     |
| pinch           | an inner edge between two border vertices would join the borders at one vertex                   |
| opposite vertex | it needs a face fan after it lost one face: 3 faces inside, 1 at a border                        |
| mirror          | an inner edge between two vertices of a mirror plane would be one edge of both halves            |
| last face       | the merged vertex keeps a face, also where the opposite vertex is a bow tie with other fans      |
| flip, any frame | a face may turn past ``TURN_COSINE`` in a few frames only (crumpling motion does so by itself)   |
| flip, the whole | ``sum over frames of n.n' sqrt(A A' w w')`` must stay positive (Yang et al. 2019, equation 7)    |

Kinds of vertices that may not collapse into each other have no cost: see :mod:`warpqem.kernels.vertex_kind`.
"""

from typing import Any

import warp as wp

from warpqem.kernels.edge_cost import INFINITE_COST, compute_edge_cost, edge_anchor, merged_position, seam_cost
from warpqem.kernels.lanes import (
    POINTS_ARRAY,
    lane_cross,
    lane_dot,
    lane_inverse_length,
    lane_kernel,
    lane_max,
)
from warpqem.kernels.member_distance import face_gap, first_pose, key_point, longest_pose, member_gap
from warpqem.kernels.mesh_state import KEY_FRAMES, AnyKeyFrames, CostModel, MeshState, degree
from warpqem.kernels.prefetch import prefetch_collapses, prefetch_ends
from warpqem.kernels.quadric import NO_PLANE
from warpqem.kernels.topology import (
    BORDER,
    MIRROR,
    NON_MANIFOLD,
    OPEN,
    find_half_edge,
    half_edge_target,
    previous_corner,
)
from warpqem.kernels.work import EdgeList, Work, count_before

# A face may not turn by more than 78 degrees in one collapse: beyond that it folds over its neighbour a few later.
TURN_COSINE = wp.constant(wp.float32(0.2))
# A cost that rose by more than this factor since it was computed puts a selected edge back among the others.
COST_SLACK = wp.constant(wp.float32(1.2))
# What the area times the squared distance of merged input vertices from the faces left costs, against the same from
# planes. Below 1 thin tips go, above 3 fits of compact shapes get worse, as one frame decides more and more.
GAP_COST = wp.constant(wp.float32(2.0))
# What the area times the squared distance of the faces left from merged input vertices costs, likewise. Below 2 faces
# span the holes of rings, above 10 fits get worse: what these vertices reach is a guess. Of 11 cells of assemblies 0, 2
# and 6 leave 0.98, 0.99 and 0.91 of the better peer's largest distance; surfaces of one piece hardly change.
FACE_GAP_COST = wp.constant(wp.float32(6.0))
# Squared normals (4 area^2 squared, in diagonals^4) below this belong to faces without an orientation: nothing to flip.
NO_AREA = wp.constant(wp.float32(1.0e-28))


@wp.func
def is_ring_vertex(state: MeshState, u: wp.int32, w: wp.int32) -> wp.bool:
    """Whether ``w`` shares a face with ``u``."""
    open_fan = (state.vertex_flags[u] & OPEN) != 0
    for i in range(state.adjacency.start[u], state.adjacency.end[u]):
        h = state.adjacency.corner[i]
        if half_edge_target(state.corner_vertex, h) == w:
            return True
        if open_fan and state.corner_vertex[previous_corner(h)] == w:
            return True
    return False


@wp.func
def mean_weight(state: MeshState, u: wp.int32, v: wp.int32) -> wp.float32:
    """What an error at the vertex that ``u`` and ``v`` become counts."""
    return 0.25 * (state.cost_weight[u] + state.cost_weight[v]) * (state.quadric_scale[u] + state.quadric_scale[v])


@wp.func
def keeps_fan(state: MeshState, opposite_vertex: wp.int32) -> wp.bool:
    """Whether an opposite vertex may lose one of its faces."""
    if (state.vertex_flags[opposite_vertex] & BORDER) != 0:
        return degree(state, opposite_vertex) >= 2
    return degree(state, opposite_vertex) >= 4


@wp.func
def is_capped(state: MeshState, u: wp.int32, v: wp.int32, left: wp.int32, right: wp.int32) -> wp.bool:
    """Whether an inner end has three faces where a non-manifold vertex is near, whose faces may be in several fans.

    The third face of that end lies between the opposite vertices, and may come to lie on one of the other end.
    """
    flags = state.vertex_flags[u] | state.vertex_flags[v] | state.vertex_flags[left]
    if right >= 0:
        flags = flags | state.vertex_flags[right]
    if (flags & NON_MANIFOLD) == 0:
        return False
    u_capped = (state.vertex_flags[u] & OPEN) == 0 and degree(state, u) == 3
    return u_capped or ((state.vertex_flags[v] & OPEN) == 0 and degree(state, v) == 3)


@wp.func
def spans_mirror(state: MeshState, u: wp.int32, v: wp.int32, left: wp.int32, right: wp.int32) -> wp.bool:
    """Whether a collapse of ``u v``, one of them on a mirror plane, makes an inner edge between two vertices of it."""
    inner = wp.where((state.vertex_flags[u] & MIRROR) != 0, v, u)
    on_plane = wp.where(inner == v, u, v)
    for i in range(state.adjacency.start[inner], state.adjacency.end[inner]):
        h = state.adjacency.corner[i]
        for side in range(2):
            w = half_edge_target(state.corner_vertex, h)
            if side == 1:
                w = state.corner_vertex[previous_corner(h)]
            if w != on_plane and w != left and w != right and (state.vertex_flags[w] & MIRROR) != 0:
                return True
    return False


@wp.func
def keeps_manifold_ends(state: MeshState, h: wp.int32) -> wp.bool:
    """Pinch, opposite vertex, mirror and last face rules for half-edge ``h``."""
    u = state.corner_vertex[h]
    v = half_edge_target(state.corner_vertex, h)
    left = state.corner_vertex[previous_corner(h)]
    right = wp.int32(-1)
    opposite = find_half_edge(state.corner_vertex, state.adjacency, v, u)
    if opposite >= 0:
        right = state.corner_vertex[previous_corner(opposite)]
        if (state.vertex_flags[u] & state.vertex_flags[v] & BORDER) != 0 or not keeps_fan(state, right):
            return False
    if not keeps_fan(state, left):
        return False
    if is_capped(state, u, v, left, right):
        return False
    if ((state.vertex_flags[u] ^ state.vertex_flags[v]) & MIRROR) != 0 and spans_mirror(state, u, v, left, right):
        return False
    removed = wp.where(opposite >= 0, 2, 1)
    return degree(state, u) + degree(state, v) > 2 * removed


@wp.func
def opposite_vertices(state: MeshState, h: wp.int32):
    """The vertices opposite the edge of half-edge ``h``; the second is -1 at a border."""
    u = state.corner_vertex[h]
    opposite = find_half_edge(state.corner_vertex, state.adjacency, half_edge_target(state.corner_vertex, h), u)
    right = wp.int32(-1)
    if opposite >= 0:
        right = state.corner_vertex[previous_corner(opposite)]
    return state.corner_vertex[previous_corner(h)], right


@wp.func
def joins_rings(
    state: MeshState, u: wp.int32, g: wp.int32, left: wp.int32, right: wp.int32, open_fan: wp.bool
) -> wp.bool:
    """Whether a neighbour of ``v`` at its corner ``g`` is one of ``u`` too, but not opposite the edge ``u v``.

    Those that enter need no look around an inner vertex.
    """
    w = half_edge_target(state.corner_vertex, g)
    if w != u and w != left and w != right and is_ring_vertex(state, u, w):
        return True
    if open_fan:
        w = state.corner_vertex[previous_corner(g)]
        if w != u and w != left and w != right and is_ring_vertex(state, u, w):
            return True
    return False


@wp.func
def meets_link_condition(state: MeshState, h: wp.int32) -> wp.bool:
    """Link condition for half-edge ``h``."""
    u = state.corner_vertex[h]
    v = half_edge_target(state.corner_vertex, h)
    left, right = opposite_vertices(state, h)
    open_fan = (state.vertex_flags[v] & OPEN) != 0
    for i in range(state.adjacency.start[v], state.adjacency.end[v]):
        if joins_rings(state, u, state.adjacency.corner[i], left, right, open_fan):
            return False
    return True


@wp.func
def flip_margin(old_normal: Any, new_normal: Any):
    """Positive (width,) where a face turns less than ``TURN_COSINE`` allows."""
    d = lane_dot(old_normal, new_normal)
    # cos |cos| >= c^2 times the squared lengths, divided before it is multiplied: d^2 of a small face underflows
    # float32.
    share = wp.cw_div(d, lane_max(lane_dot(old_normal, old_normal), NO_AREA))
    return wp.cw_mul(share, wp.abs(d)) - TURN_COSINE * TURN_COSINE * lane_dot(new_normal, new_normal)


@wp.func
def turns_over(
    state: MeshState,
    frames: AnyKeyFrames,
    corner: wp.int32,
    target: Any,
    slot: wp.int32,
    flip_tolerance: wp.int32,
) -> wp.bool:
    """Whether the face at ``corner`` breaks a flip rule when the corner's vertex moves to ``target[slot]``."""
    a = state.corner_vertex[corner]
    b = half_edge_target(state.corner_vertex, corner)
    c = state.corner_vertex[previous_corner(corner)]
    flips = wp.int32(0)
    for t in range(frames.position.shape[1]):
        p = frames.position[b, t]
        edge = frames.position[c, t] - p
        n = lane_cross(edge, frames.position[a, t] - p)
        margin = flip_margin(n, lane_cross(edge, target[slot, t] - p))
        if wp.min(margin) <= 0.0:
            square = lane_dot(n, n)
            for k in range(len(margin)):
                # A face without area in the old state cannot flip.
                if margin[k] <= 0.0 and square[k] > NO_AREA:
                    flips += 1
            if flips > flip_tolerance:
                return True
    if flips == 0:
        return False
    # All frames together: n.n' sqrt(A A'), with both normals as long as twice the area. The vertex weights of
    # equation 7 are the same factor in every frame, so they do not change the sum's sign.
    agreement = wp.float32(0.0)
    for t in range(frames.position.shape[1]):
        p = frames.position[b, t]
        edge = frames.position[c, t] - p
        n = lane_cross(edge, frames.position[a, t] - p)
        m = lane_cross(edge, target[slot, t] - p)
        scale = wp.cw_mul(lane_inverse_length(n), lane_inverse_length(m))
        d = lane_dot(n, m)
        for k in range(len(d)):
            agreement += d[k] * wp.sqrt(scale[k])
    return agreement <= 0.0


@lane_kernel(frames=KEY_FRAMES, target_out=POINTS_ARRAY)
def place_collapses(
    # in
    state: MeshState,
    frames: AnyKeyFrames,
    model: CostModel,
    selected: EdgeList,
    work: Work,
    # out
    target_out: Any,
    anchor_out: wp.array[wp.float32],
):
    """The merged vertex of each selected collapse in each key frame, and the anchor along its edge."""
    first_slot = count_before(selected, work.part)
    for k in range(wp.tid(), selected.count[work.part], work.thread_count):
        i = first_slot + k
        prefetch_ends(state, frames, selected, work, k)
        h = selected.half_edge[work.part * selected.capacity + k]
        u = state.corner_vertex[h]
        v = half_edge_target(state.corner_vertex, h)
        anchor = edge_anchor(state, frames, model, u, v)
        anchor_out[i] = anchor
        for t in range(frames.position.shape[1]):
            target_out[i, t] = merged_position(state, frames, model, u, v, t, anchor)


@wp.func
def gap_error(gap: wp.vec2) -> wp.float32:
    """Mean squared distance of the input vertices that a collapse merges, see :func:`member_gap`."""
    return gap[0] / wp.max(gap[1], NO_PLANE)


@wp.func
def settle_collapse(
    state: MeshState,
    frames: AnyKeyFrames,
    model: CostModel,
    h: wp.int32,
    legal: wp.bool,
    gap: wp.vec2,
    back: wp.float32,
) -> wp.int32:
    """The faces that the collapse of half-edge ``h`` removes, if it goes ahead; else 0, and its cost says why.

    Args:
        state: its edge's cost is changed where it does not go ahead.
        frames: the key frames.
        model: the cost model.
        h: the half-edge.
        legal: whether it keeps all rules.
        gap: what :func:`member_gap` measures for a legal one.
        back: what :func:`face_gap` measures for a legal one whose gap is no larger than the limit of the error.
    """
    u = state.corner_vertex[h]
    v = half_edge_target(state.corner_vertex, h)
    cost = state.edge_cost[h]
    if legal and seam_cost(state, h) > 0.0:
        fresh = compute_edge_cost(state, frames, model, h)
        cost = fresh.cost
    if legal:
        if gap_error(gap) > model.error_limit:
            cost = INFINITE_COST
        else:
            cost = wp.max(cost, GAP_COST * model.key_count * mean_weight(state, u, v) * gap[0])
            cost = wp.max(cost, model.key_count * mean_weight(state, u, v) * (FACE_GAP_COST * back))
    if cost > COST_SLACK * state.edge_cost[h]:
        state.edge_cost[h] = cost
        return 0
    if legal:
        opposite = find_half_edge(state.corner_vertex, state.adjacency, v, u)
        return wp.where(opposite >= 0, 2, 1)
    state.edge_cost[h] = -state.edge_cost[h]
    return 0


@lane_kernel(frames=KEY_FRAMES, target_in=POINTS_ARRAY)
def check_collapses(
    # in and out
    state: MeshState,
    # in
    frames: AnyKeyFrames,
    model: CostModel,
    selected: EdgeList,
    target_in: Any,
    flip_tolerance: wp.int32,
    work: Work,
    # out
    faces_removed_out: wp.array[wp.int32],
    error_out: wp.array[wp.float32],
    legal_count: wp.array[wp.int32],
    space: wp.array[wp.int32],
):
    """The faces each legal collapse removes; 0 for an illegal one, suspended until its neighbourhood changes.

    Also 0 for one with more than its stored cost: input vertices would be far from the faces left, or a seam has come
    to the edge from across its faces, where no cost is updated. ``error_out`` is the mean squared distance of the input
    vertices that a legal collapse merges. Counts the legal ones of each part too, and the entries that their adjacency
    takes (both zeroed before the launch, or empty: then not).
    """
    first_slot = count_before(selected, work.part)
    for k in range(wp.tid(), selected.count[work.part], work.thread_count):
        i = first_slot + k
        prefetch_collapses(state, frames, selected, work, k)
        h = selected.half_edge[work.part * selected.capacity + k]
        u = state.corner_vertex[h]
        v = half_edge_target(state.corner_vertex, h)
        legal = keeps_manifold_ends(state, h) and meets_link_condition(state, h)
        for side in range(2):
            a = wp.where(side == 0, u, v)
            b = wp.where(side == 0, v, u)
            j = state.adjacency.start[a]
            while legal and j < state.adjacency.end[a]:
                g = state.adjacency.corner[j]
                if half_edge_target(state.corner_vertex, g) != b and state.corner_vertex[previous_corner(g)] != b:
                    legal = not turns_over(state, frames, g, target_in, i, flip_tolerance)
                j += 1
        gap = wp.vec2(0.0, 0.0)
        back = wp.float32(0.0)
        if legal:
            first = first_pose(target_in, i)
            longest = longest_pose(frames, model, u, v)
            longest.apex = key_point(target_in, i, longest.frame)
            gap = member_gap(state, frames, u, v, first, longest)
            error_out[i] = gap_error(gap)
            if gap_error(gap) <= model.error_limit:
                back = face_gap(state, frames, u, v, first, longest)
        faces_removed = settle_collapse(state, frames, model, h, legal, gap, back)
        faces_removed_out[i] = faces_removed
        if faces_removed > 0 and legal_count.shape[0] > 0:
            wp.atomic_add(legal_count, work.part, 1)
            wp.atomic_add(space, work.part, degree(state, u) + degree(state, v))
