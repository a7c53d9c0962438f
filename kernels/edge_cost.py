"""Cost of an edge collapse summed over key frames, and where each collapse puts its vertex.

The sum over frames is Mohr & Gleicher's deformation sensitive decimation (2003); the material anchor along the edge is
ours: one constant ``lambda`` for all frames, so that soft directions follow the material instead of sliding.
"""

import warp as wp

from warpqem.kernels.attribute import attribute_error, attribute_parabola, first_frame
from warpqem.kernels.deformation import length_deformation
from warpqem.kernels.lanes import lane_dot, lane_kernel, lane_max, lane_sum
from warpqem.kernels.mesh_state import KEY_FRAMES, AnyKeyFrames, CollapseLog, CostModel, MeshState
from warpqem.kernels.prefetch import prefetch_moved
from warpqem.kernels.quadric import (
    NO_PLANE,
    anchored_minimiser,
    apply_matrix,
    linear_part,
    shift_origin,
    trace,
    value_at_minimiser,
)
from warpqem.kernels.topology import (
    CORNER,
    PINNED,
    SEAM,
    find_half_edge,
    half_edge_target,
    is_canonical,
    next_corner,
    previous_corner,
)
from warpqem.kernels.vertex_kind import may_collapse, may_collapse_into
from warpqem.kernels.work import Work, first_item, last_item

wp.set_module_options({"enable_backward": False})  # no gradients are taken

INFINITE_COST = wp.constant(wp.float32(wp.inf))
# Costs stay above zero, so that the sign is free to mean "suspended" and the float's bits order the edges.
MIN_COST = wp.constant(wp.float32(1.0e-37))
# Regularisation towards the middle of the edge, relative to the stiffness of the quadrics: it decides where these leave
# the anchor open (faces that are flat, or none), and is far below the stiffness of any curvature.
MIDDLE_REGULARISATION = wp.constant(wp.float32(1.0e-5))
# On flat ground every edge costs nothing. This part of area x length^2 makes short edges go first, far below the cost
# of any visible bend, so that triangles stay compact.
LENGTH_COST = wp.constant(wp.float32(1.0e-8))
# Threads for the edges around a vertex: most have six faces, and each of their twelve half-edges there a thread.
RING_SLOTS = wp.constant(wp.int32(16))
# A collapse that changes how seams run counts as an error of this part of the edge's length, squared: costly enough
# that seams stay as long as the shape has something to spare, and that the smallest go first.
SEAM_COST = wp.constant(wp.float32(0.01))
# One that takes the last face of an island, and so a part of the texture, likewise: four times as much.
ISLAND_COST = wp.constant(wp.float32(0.04))


@wp.struct
class EdgeCost:
    """What a collapse costs (area x length^2, weighted) and its mean squared error (length^2)."""

    cost: wp.float32
    error: wp.float32


@wp.func
def merged_quadric(frames: AnyKeyFrames, u: wp.int32, v: wp.int32, t: wp.int32, anchor: wp.float32):
    """``Q_u + Q_v`` about the material point ``p_u + anchor (p_v - p_u)``, in block ``t``."""
    d = frames.position[v, t] - frames.position[u, t]
    return shift_origin(frames.quadric[u, t], anchor * d) + shift_origin(frames.quadric[v, t], (anchor - 1.0) * d)


@wp.func
def forced_anchor(state: MeshState, u: wp.int32, v: wp.int32) -> wp.float32:
    """The anchor where one end may only collapse into the other: 0 at ``u``, 1 at ``v``. Else -1."""
    u_goes = may_collapse_into(state.vertex_flags[u], state.vertex_flags[v])
    v_goes = may_collapse_into(state.vertex_flags[v], state.vertex_flags[u])
    if u_goes != v_goes:
        return wp.where(u_goes, wp.float32(1.0), wp.float32(0.0))
    return wp.float32(-1.0)


@wp.func
def anchor_terms(frames: AnyKeyFrames, u: wp.int32, v: wp.int32, t: wp.int32):
    """What the anchor of an edge sums over the blocks of frames: slope, stiffness and regularisation."""
    # d.b and d^T A d of the merged quadric, without building it: this is half the time of an edge's cost.
    d = frames.position[v, t] - frames.position[u, t]
    qu = frames.quadric[u, t]
    qv = frames.quadric[v, t]
    bend_u = lane_dot(d, apply_matrix(qu, d))
    bend_v = lane_dot(d, apply_matrix(qv, d))
    slope = lane_sum(lane_dot(d, linear_part(qu) + linear_part(qv)) - bend_v)
    return slope, lane_sum(bend_u + bend_v), wp.dot(trace(qu) + trace(qv), lane_dot(d, d))


@wp.func
def anchor_of_terms(
    state: MeshState,
    model: CostModel,
    u: wp.int32,
    v: wp.int32,
    slope_sum: wp.float32,
    stiffness_sum: wp.float32,
    regularisation_sum: wp.float32,
) -> wp.float32:
    """The anchor of an edge that may collapse both ways, given its terms summed over all frames."""
    slope = wp.float32(slope_sum)
    stiffness = wp.float32(stiffness_sum)
    if state.wedges.channel_count > 0:
        bend = attribute_parabola(state, u, v)
        slope += bend[0]
        stiffness += bend[1]
    if model.endpoint == 1:
        # Q(1) - Q(0) = 2 b.d + d^T A d
        return wp.where(2.0 * slope + stiffness < 0.0, wp.float32(1.0), wp.float32(0.0))
    regularisation = MIDDLE_REGULARISATION * regularisation_sum
    if stiffness + regularisation <= NO_PLANE:
        return 0.5
    return wp.clamp((0.5 * regularisation - slope) / (stiffness + regularisation), 0.0, 1.0)


@wp.func
def edge_anchor(state: MeshState, frames: AnyKeyFrames, model: CostModel, u: wp.int32, v: wp.int32) -> wp.float32:
    """``lambda`` of the material anchor ``(1 - lambda) p_u + lambda p_v``: minimises the quadrics' sum over all frames.

    Where one end may only collapse into the other, the other is the anchor.
    """
    forced = forced_anchor(state, u, v)
    if forced >= 0.0:
        return forced
    slope = wp.float32(0.0)
    stiffness = wp.float32(0.0)
    regularisation = wp.float32(0.0)
    for t in range(frames.position.shape[1]):
        added_slope, added_stiffness, added_regularisation = anchor_terms(frames, u, v, t)
        slope += added_slope
        stiffness += added_stiffness
        regularisation += added_regularisation
    return anchor_of_terms(state, model, u, v, slope, stiffness, regularisation)


@wp.func
def keeps_anchor(state: MeshState, model: CostModel, u: wp.int32, v: wp.int32) -> wp.bool:
    """Whether the merged vertex goes to the anchor itself: always to an end, or to a pinned vertex."""
    return model.endpoint == 1 or ((state.vertex_flags[u] | state.vertex_flags[v]) & PINNED) != 0


@wp.func
def merged_position(
    state: MeshState,
    frames: AnyKeyFrames,
    model: CostModel,
    u: wp.int32,
    v: wp.int32,
    t: wp.int32,
    anchor: wp.float32,
):
    """Where a collapse puts its vertex in block ``t``, given the anchor of its edge."""
    p = frames.position[u, t]
    x = p + anchor * (frames.position[v, t] - p)
    if not keeps_anchor(state, model, u, v):
        x += anchored_minimiser(merged_quadric(frames, u, v, t, anchor), model.epsilon)
    return x


@wp.func
def opposite_half_edge(state: MeshState, h: wp.int32) -> wp.int32:
    """The half-edge that runs the other way; -1 at a border."""
    return find_half_edge(
        state.corner_vertex, state.adjacency, half_edge_target(state.corner_vertex, h), state.corner_vertex[h]
    )


@wp.func
def ends_island(state: MeshState, h: wp.int32) -> wp.bool:
    """Whether an island ends at half-edge ``h``: it is on a seam or a border."""
    return state.seam[h] == 1 or opposite_half_edge(state, h) < 0


@wp.func
def closes_island(state: MeshState, h: wp.int32) -> wp.bool:
    """Whether nothing of its island lies beyond the two other edges of the face of half-edge ``h``."""
    return ends_island(state, next_corner(h)) and ends_island(state, previous_corner(h))


@wp.func
def takes_island(state: MeshState, h: wp.int32) -> wp.bool:
    """Whether the collapse of half-edge ``h`` takes the last faces of an island."""
    closes = closes_island(state, h)
    opposite = opposite_half_edge(state, h)
    if opposite < 0:
        return closes
    beyond = closes_island(state, opposite)
    # Off seams both faces are of one island.
    return wp.where(state.seam[h] == 1, closes or beyond, closes and beyond)


@wp.func
def seam_cost(state: MeshState, h: wp.int32) -> wp.float32:
    """What the collapse of half-edge ``h`` costs for how it changes seams, in parts of the edge's length, squared.

    It joins two seams across the surface between them, or two corners of seams, or takes an island's last face; 0 for
    one that does none of this.
    """
    u = state.corner_vertex[h]
    v = half_edge_target(state.corner_vertex, h)
    common = state.vertex_flags[u] & state.vertex_flags[v]
    if (common & SEAM) == 0:
        return 0.0
    if takes_island(state, h):
        return ISLAND_COST
    if (common & CORNER) != 0 or state.seam[h] == 0:
        return SEAM_COST
    return 0.0


@wp.func
def compute_edge_cost(state: MeshState, frames: AnyKeyFrames, model: CostModel, h: wp.int32) -> EdgeCost:
    """Cost over key frames of the collapse of half-edge ``h``; an infinite cost where no collapse is allowed."""
    u = state.corner_vertex[h]
    v = half_edge_target(state.corner_vertex, h)
    result = EdgeCost()
    result.cost = INFINITE_COST
    if not may_collapse(state.vertex_flags[u], state.vertex_flags[v]):
        return result
    anchor = edge_anchor(state, frames, model, u, v)
    at_anchor = keeps_anchor(state, model, u, v)
    total = wp.float32(0.0)
    area = wp.float32(0.0)
    spread = wp.float32(0.0)
    for t in range(frames.position.shape[1]):
        q = merged_quadric(frames, u, v, t, anchor)
        d = frames.position[v, t] - frames.position[u, t]
        if at_anchor:
            total += lane_sum(lane_max(q[9], 0.0))
        else:
            total += lane_sum(value_at_minimiser(q, anchored_minimiser(q, model.epsilon), model.epsilon))
        area += lane_sum(trace(q))
        spread += wp.dot(trace(q), lane_dot(d, d))
    total += seam_cost(state, h) * spread
    result.error = total / wp.max(area, NO_PLANE)
    if result.error > model.error_limit:
        return result
    weight = 0.5 * (state.cost_weight[u] + state.cost_weight[v])
    if state.wedges.channel_count > 0:
        x = merged_position(state, frames, model, u, v, 0, anchor)
        total += attribute_error(state, u, v, first_frame(x))
    result.cost = weight * (total + LENGTH_COST * spread) + MIN_COST
    if model.deformation_weight > 0.0:
        result.cost += model.deformation_weight * length_deformation(state, h)
    return result


@wp.func
def cost_at(state: MeshState, frames: AnyKeyFrames, model: CostModel, h: wp.int32) -> wp.float32:
    """What stands at half-edge ``h`` of a live face: the cost of its edge, once for both half-edges."""
    cost = INFINITE_COST
    if is_canonical(state.corner_vertex, state.adjacency, state.vertex_flags, h):
        result = compute_edge_cost(state, frames, model, h)
        cost = result.cost
    return cost


@lane_kernel(frames=KEY_FRAMES)
def compute_all_costs(
    # in and out
    state: MeshState,
    # in
    frames: AnyKeyFrames,
    model: CostModel,
    work: Work,
):
    """The costs of all edges of the mesh, into ``state.edge_cost``."""
    half_edge_count = 3 * state.face_count[0]
    for h in range(first_item(half_edge_count, work) + wp.tid(), last_item(half_edge_count, work), work.thread_count):
        cost = INFINITE_COST
        if state.corner_vertex[h] >= 0:
            cost = cost_at(state, frames, model, h)
        state.edge_cost[h] = cost


@wp.func
def opposite_edge(state: MeshState, h: wp.int32) -> wp.int32:
    """The half-edge that stands for the edge across the face of ``h`` from the vertex where ``h`` begins."""
    across = next_corner(h)
    if is_canonical(state.corner_vertex, state.adjacency, state.vertex_flags, across):
        return across
    a = state.corner_vertex[across]
    return find_half_edge(state.corner_vertex, state.adjacency, half_edge_target(state.corner_vertex, across), a)


@lane_kernel(frames=KEY_FRAMES)
def update_moved_costs(
    # in and out
    state: MeshState,
    # in
    frames: AnyKeyFrames,
    model: CostModel,
    log: CollapseLog,
    pass_begin: wp.array[wp.int32],
    work: Work,
):
    """Update the costs of the edges at each vertex that the last pass moved.

    Vertices that one pass moves are never neighbours, so each such edge has exactly one moved end. The deformation term
    weighs an edge by the area of its faces, so with it the edges opposite a moved vertex cost something else too. Their
    ends stay; two moved vertices may share one, and both then write the same cost.

    Where there are many threads, those of a vertex take turns with its edges.
    """
    moved_count = log.count[0] - pass_begin[0]
    sides = wp.where(model.deformation_weight > 0.0, 3, 2)
    slots = wp.where(work.thread_count > 1, RING_SLOTS, 1)
    first = slots * first_item(moved_count, work)
    for item in range(first + wp.tid(), slots * last_item(moved_count, work), work.thread_count):
        i = item // slots
        prefetch_moved(state, frames, log.kept, pass_begin[0] + i, log.count[0], work)
        u = log.kept[pass_begin[0] + i]
        # The edges of a face in one loop: a loop of two or three would be unrolled, and an edge's cost is most of what
        # there is to compile.
        for j in range(sides * state.adjacency.start[u] + item % slots, sides * state.adjacency.end[u], slots):
            h = state.adjacency.corner[j // sides]
            side = j % sides
            if side == 1:
                h = previous_corner(h)
            elif side == 2:
                h = opposite_edge(state, h)
            # An edge where orientations differ may have none; it stays between two pinned ends, without a cost.
            if h >= 0:
                state.edge_cost[h] = cost_at(state, frames, model, h)


@lane_kernel(frames=KEY_FRAMES)
def update_neighbourhood_costs(
    # in and out
    state: MeshState,
    # in
    frames: AnyKeyFrames,
    model: CostModel,
    mask_in: wp.array[wp.int32],
    pass_number_in: wp.array[wp.int32],
    work: Work,
):
    """Update the costs of the edges that have an end among the vertices that this pass masked."""
    half_edge_count = 3 * state.face_count[0]
    for h in range(first_item(half_edge_count, work) + wp.tid(), last_item(half_edge_count, work), work.thread_count):
        u = state.corner_vertex[h]
        if u >= 0:
            v = half_edge_target(state.corner_vertex, h)
            if mask_in[u] == pass_number_in[0] or mask_in[v] == pass_number_in[0]:
                state.edge_cost[h] = cost_at(state, frames, model, h)


@wp.kernel
def resume_neighbourhoods(
    # in and out
    state: MeshState,
    # in
    mask_in: wp.array[wp.int32],
    pass_number_in: wp.array[wp.int32],
    work: Work,
):
    """Resume the suspended edges around each vertex that moved: their faces changed, so they may be legal now.

    These are the edges with an end that this pass masked: a mask covers the one-rings of both ends of a collapse.
    """
    half_edge_count = 3 * state.face_count[0]
    last = last_item(half_edge_count, work)
    h = first_item(half_edge_count, work) + wp.tid()
    while h < last:
        cost = state.edge_cost[h]
        if cost < 0.0:
            u = state.corner_vertex[h]
            v = half_edge_target(state.corner_vertex, h)
            if mask_in[u] == pass_number_in[0] or mask_in[v] == pass_number_in[0]:
                state.edge_cost[h] = -cost
        h += work.thread_count
