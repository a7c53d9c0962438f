"""Commit the collapses of one round, and compact the faces that are left."""

from typing import Any

import warp as wp

from warpqem.kernels.attribute import first_frame, merge_wedges
from warpqem.kernels.edge_cost import INFINITE_COST, merged_quadric
from warpqem.kernels.lanes import POINTS_ARRAY, lane_kernel, lane_max, lane_sum
from warpqem.kernels.member_distance import join_members
from warpqem.kernels.mesh_state import KEY_FRAMES, AnyKeyFrames, CollapseLog, MeshState, degree
from warpqem.kernels.prefetch import prefetch_adjacency, prefetch_collapses
from warpqem.kernels.quadric import NO_PLANE, shift_origin, trace
from warpqem.kernels.quadric_sums import merge_sum, merge_sum_rows
from warpqem.kernels.topology import (
    BORDER,
    CORNER,
    OPEN,
    SEAM,
    find_half_edge,
    half_edge_target,
    next_corner,
    previous_corner,
)
from warpqem.kernels.vertex_kind import removed_end
from warpqem.kernels.work import EdgeList, Work, count_before, first_item, last_item

wp.set_module_options({"enable_backward": False})  # no gradients are taken


@wp.func
def merge_frame(state: MeshState, frames: AnyKeyFrames, u: wp.int32, v: wp.int32, x: Any, t: wp.int32):
    """Move ``u`` to ``x`` in block ``t``, with the quadrics of both; area times squared error there, and area."""
    if state.sum_row.shape[0] > 0:
        merge_sum(state, frames, u, v, x, t)
    p = frames.position[u, t]
    q = shift_origin(merged_quadric(frames, u, v, t, 0.0), x - p)
    frames.quadric[u, t] = q
    frames.position[u, t] = x
    return lane_sum(lane_max(q[9], 0.0)), lane_sum(trace(q))


@wp.func
def merge_vertex(
    state: MeshState, frames: AnyKeyFrames, u: wp.int32, v: wp.int32, target: Any, slot: wp.int32
) -> wp.float32:
    """Move ``u`` to the target in every frame, with the quadrics of both; the mean squared error is returned."""
    total = wp.float32(0.0)
    area = wp.float32(0.0)
    for t in range(frames.position.shape[1]):
        added_total, added_area = merge_frame(state, frames, u, v, target[slot, t], t)
        total += added_total
        area += added_area
    return total / wp.max(area, NO_PLANE)


@wp.func
def merge_values(state: MeshState, u: wp.int32, v: wp.int32):
    """What ``u`` has of both ends that is no frame's: flags, weights, rows and members."""
    if state.sum_row.shape[0] > 0:
        merge_sum_rows(state, u, v)
    state.vertex_flags[u] = state.vertex_flags[u] | state.vertex_flags[v]
    state.cost_weight[u] = 0.5 * (state.cost_weight[u] + state.cost_weight[v])
    state.quadric_scale[u] = 0.5 * (state.quadric_scale[u] + state.quadric_scale[v])
    join_members(state, u, v)


@wp.func
def join_seams(state: MeshState, u: wp.int32, v: wp.int32, h: wp.int32):
    """The two edges that the face of ``h`` keeps apart become one: a seam when either is.

    Their half-edges in the neighbouring faces are looked up in the adjacency of ``u`` and ``v``, which no other
    selected collapse touches.
    """
    opposite_vertex = state.corner_vertex[previous_corner(h)]
    # The flags of vertices are nearer than those of half-edges, and most opposite vertices have none.
    if (state.vertex_flags[opposite_vertex] & SEAM) == 0:
        return
    if state.seam[next_corner(h)] == 0 and state.seam[previous_corner(h)] == 0:
        return
    for side in range(2):
        a = wp.where(side == 0, u, v)
        b = wp.where(side == 0, v, u)
        for i in range(state.adjacency.start[a], state.adjacency.end[a]):
            out = state.adjacency.corner[i]
            into = previous_corner(out)
            if half_edge_target(state.corner_vertex, out) == opposite_vertex and state.corner_vertex[into] != b:
                state.seam[out] = 1
            if state.corner_vertex[into] == opposite_vertex and half_edge_target(state.corner_vertex, out) != b:
                state.seam[into] = 1


@wp.func
def seam_degree(state: MeshState, u: wp.int32, v: wp.int32) -> wp.int32:
    """Seam edges at ``u`` after ``v`` has become ``u``: a seam edge lies inside, so one of its half-edges leaves it."""
    count = wp.int32(0)
    for side in range(2):
        a = wp.where(side == 0, u, v)
        for i in range(state.adjacency.start[a], state.adjacency.end[a]):
            h = state.adjacency.corner[i]
            if state.corner_vertex[h] == u:
                count += state.seam[h]
    return count


@wp.func
def classify_seams(state: MeshState, u: wp.int32, v: wp.int32):
    """Set the seam flags of ``u`` anew after ``v`` has become ``u``."""
    flags = state.vertex_flags[u]
    if (flags & SEAM) != 0:
        count = seam_degree(state, u, v)
        flags = flags & ~(SEAM | CORNER)
        if count > 0:
            flags = flags | SEAM
        if count > 0 and (count != 2 or (flags & BORDER) != 0):
            flags = flags | CORNER
        state.vertex_flags[u] = flags


@wp.func
def mask_ring(state: MeshState, mask: wp.array[wp.int32], pass_index: wp.int32, v: wp.int32):
    """Mask a vertex and its one-ring for the rest of the pass."""
    mask[v] = pass_index
    open_fan = (state.vertex_flags[v] & OPEN) != 0
    for i in range(state.adjacency.start[v], state.adjacency.end[v]):
        h = state.adjacency.corner[i]
        mask[half_edge_target(state.corner_vertex, h)] = pass_index
        if open_fan:
            mask[state.corner_vertex[previous_corner(h)]] = pass_index


@wp.func
def merge_adjacency(state: MeshState, u: wp.int32, v: wp.int32, first: wp.int32):
    """The corners of ``u``: those that both ends have left, from ``first`` on in the pool; none for ``v``."""
    i = state.adjacency.start[u]
    j = state.adjacency.start[v]
    last_i = state.adjacency.end[u]
    last_j = state.adjacency.end[v]
    last = wp.int32(first)
    h = wp.int32(-1)
    while i < last_i or j < last_j:
        from_u = j >= last_j
        if i < last_i and j < last_j:
            from_u = state.adjacency.corner[i] < state.adjacency.corner[j]
        if from_u:
            h = state.adjacency.corner[i]
            i += 1
        else:
            h = state.adjacency.corner[j]
            j += 1
        if state.corner_vertex[h] >= 0:
            state.adjacency.corner[last] = h
            last += 1
    state.adjacency.start[u] = first
    state.adjacency.end[u] = last
    state.adjacency.end[v] = state.adjacency.start[v]


@wp.kernel
def remove_dead_corners(
    # in and out
    state: MeshState,
    # in
    log: CollapseLog,
    pass_begin: wp.array[wp.int32],
    pass_number_in: wp.array[wp.int32],
    work: Work,
    # in and out
    updated: wp.array[wp.int32],
):
    """Remove the dead corners of the vertices opposite the last pass's edges. A part does so for its own vertices.

    A vertex may lie opposite two edges; ``updated`` (the number of the pass that last did it) lets one thread in.
    """
    first_vertex = first_item(updated.shape[0], work)
    last_vertex = last_item(updated.shape[0], work)
    for i in range(pass_begin[0] + wp.tid(), log.count[0], work.thread_count):
        prefetch_adjacency(state, log.left_opposite, i, log.count[0], work)
        prefetch_adjacency(state, log.right_opposite, i, log.count[0], work)
        for side in range(2):
            w = wp.where(side == 0, log.left_opposite[i], log.right_opposite[i])
            mine = w >= first_vertex and w < last_vertex
            if mine and wp.atomic_max(updated, w, pass_number_in[0]) < pass_number_in[0]:
                last = state.adjacency.start[w]
                for j in range(last, state.adjacency.end[w]):
                    h = state.adjacency.corner[j]
                    if state.corner_vertex[h] >= 0:
                        state.adjacency.corner[last] = h
                        last += 1
                state.adjacency.end[w] = last


@wp.kernel
def open_log(
    # in and out
    legal_count: wp.array[wp.int32],
    space: wp.array[wp.int32],
    log: CollapseLog,
    # out
    log_slot: wp.array[wp.int32],
    # in and out
    pool_used: wp.array[wp.int32],
    # out
    pool_slot: wp.array[wp.int32],
):
    """Reserve room for the legal collapses of each part, in the log and in the adjacency pool.

    Their counts are cleared for the next round.
    """
    log.round_count[0] = log.round_count[0] + 1
    slot = log.count[0]
    for part in range(legal_count.shape[0]):
        log_slot[part] = slot
        slot += legal_count[part]
        legal_count[part] = 0
    log.count[0] = slot
    entry = pool_used[0]
    for part in range(space.shape[0]):
        pool_slot[part] = entry
        entry += space[part]
        space[part] = 0
    pool_used[0] = entry


@wp.func
def log_collapse(
    state: MeshState, log: CollapseLog, slot: wp.int32, u: wp.int32, v: wp.int32, h: wp.int32, opposite: wp.int32
):
    """Log the collapse of half-edge ``h``, and ``opposite`` or -1, that keeps ``u`` and removes ``v``."""
    log.kept[slot] = u
    log.removed[slot] = v
    log.left_opposite[slot] = state.corner_vertex[previous_corner(h)]
    log.right_opposite[slot] = -1
    if opposite >= 0:
        log.right_opposite[slot] = state.corner_vertex[previous_corner(opposite)]
    log.cost[slot] = state.edge_cost[h]
    log.round_index[slot] = log.round_count[0]


@wp.func
def merge_corners(state: MeshState, u: wp.int32, v: wp.int32):
    """Hand the corners of ``v`` to ``u``, but for those of faces with both, which die."""
    for i in range(state.adjacency.start[v], state.adjacency.end[v]):
        h = state.adjacency.corner[i]
        f = h // 3
        if half_edge_target(state.corner_vertex, h) == u or state.corner_vertex[previous_corner(h)] == u:
            for k in range(3):
                state.corner_vertex[3 * f + k] = -1
                state.edge_cost[3 * f + k] = INFINITE_COST
        else:
            state.corner_vertex[h] = u


@wp.func
def ends_of(state: MeshState, h: wp.int32):
    """The vertex that the collapse of half-edge ``h`` keeps, the lower or the pinned one, and the one it removes."""
    a = state.corner_vertex[h]
    b = half_edge_target(state.corner_vertex, h)
    v = removed_end(state.vertex_flags, a, b)
    return wp.where(v == a, b, a), v


@wp.func
def commit_collapse(
    state: MeshState,
    h: wp.int32,
    anchor: wp.float32,
    lead: Any,
    pass_number: wp.int32,
    part: wp.int32,
    mask: wp.array[wp.int32],
    log: CollapseLog,
    log_slot: wp.array[wp.int32],
    pool_slot: wp.array[wp.int32],
) -> wp.int32:
    """Apply and log the collapse of half-edge ``h``, but for the frames and the error; its slot in the log.

    ``anchor`` is that of its edge, ``lead`` the block of frames that its vertex goes to with the first.
    """
    a = state.corner_vertex[h]
    opposite = find_half_edge(state.corner_vertex, state.adjacency, half_edge_target(state.corner_vertex, h), a)
    u, v = ends_of(state, h)
    slot = wp.atomic_add(log_slot, part, 1)
    log_collapse(state, log, slot, u, v, h, opposite)
    mask_ring(state, mask, pass_number, u)
    mask_ring(state, mask, pass_number, v)
    if state.trajectory.shape[0] > 0:
        # Every frame of it moves after the pass, see :func:`move_trajectories`.
        for chunk in range(state.deformation.anchor.shape[1]):
            state.deformation.anchor[u, chunk] = wp.where(u == a, anchor, 1.0 - anchor)
    if state.wedges.channel_count > 0:
        merge_wedges(state, u, v, first_frame(lead))
    merge_values(state, u, v)
    join_seams(state, u, v, h)
    if opposite >= 0:
        join_seams(state, u, v, opposite)
    merge_corners(state, u, v)
    classify_seams(state, u, v)
    adjacency_size = degree(state, u) + degree(state, v)
    entry = wp.atomic_add(pool_slot, part, adjacency_size)
    # A pool without room for it is known by its count: then the adjacency is built anew after the pass.
    if entry + adjacency_size <= state.adjacency.corner.shape[0]:
        merge_adjacency(state, u, v, entry)
    return slot


@lane_kernel(frames=KEY_FRAMES, target_in=POINTS_ARRAY)
def commit_collapses(
    # in and out
    state: MeshState,
    frames: AnyKeyFrames,
    # in
    selected: EdgeList,
    faces_removed_in: wp.array[wp.int32],
    target_in: Any,
    anchor_in: wp.array[wp.float32],
    error_in: wp.array[wp.float32],
    pass_number_in: wp.array[wp.int32],
    work: Work,
    # out
    mask: wp.array[wp.int32],
    # in and out
    log: CollapseLog,
    log_slot: wp.array[wp.int32],
    pool_slot: wp.array[wp.int32],
):
    """Apply and log the legal collapses, those that remove faces.

    The adjacency of the vertex kept is put together at once: no other collapse of the pass reads it. That of the
    opposite vertices stays as it is until the pass is over.
    """
    first_slot = count_before(selected, work.part)
    for w in range(wp.tid(), selected.count[work.part], work.thread_count):
        i = first_slot + w
        prefetch_collapses(state, frames, selected, work, w)
        if faces_removed_in[i] > 0:
            h = selected.half_edge[work.part * selected.capacity + w]
            u, v = ends_of(state, h)
            error = merge_vertex(state, frames, u, v, target_in, i)
            lead = target_in[i, 0]
            slot = commit_collapse(
                state, h, anchor_in[i], lead, pass_number_in[0], work.part, mask, log, log_slot, pool_slot
            )
            log.faces_removed[slot] = faces_removed_in[i]
            log.error[slot] = wp.max(error_in[i], error)


@wp.kernel
def remove_from_adjacency(
    # in and out
    state: MeshState,
    # in
    vertex_in: wp.array[wp.int32],
):
    """Take the faces of all vertices of a component off the mesh; threads that share a face write the same."""
    v = vertex_in[wp.tid()]
    for i in range(state.adjacency.start[v], state.adjacency.end[v]):
        f = state.adjacency.corner[i] // 3
        for k in range(3):
            state.corner_vertex[3 * f + k] = -1
            state.edge_cost[3 * f + k] = INFINITE_COST
    state.adjacency.end[v] = state.adjacency.start[v]


@wp.kernel
def mark_live_faces(
    # in
    corner_vertex_in: wp.array[wp.int32],
    # out
    live_out: wp.array[wp.int32],
):
    """1 for each live face."""
    f = wp.tid()
    live_out[f] = wp.where(corner_vertex_in[3 * f] >= 0, 1, 0)


@wp.kernel
def move_live_faces(
    # in
    corner_vertex_in: wp.array[wp.int32],
    edge_cost_in: wp.array[wp.float32],
    seam_in: wp.array[wp.int32],
    live_rank_in: wp.array[wp.int32],
    # out
    corner_vertex_out: wp.array[wp.int32],
    edge_cost_out: wp.array[wp.float32],
    seam_out: wp.array[wp.int32],
):
    """Close the gaps between live faces, keeping their order; ``live_rank_in`` is the inclusive sum of live flags."""
    f = wp.tid()
    if corner_vertex_in[3 * f] >= 0:
        g = live_rank_in[f] - 1
        for k in range(3):
            corner_vertex_out[3 * g + k] = corner_vertex_in[3 * f + k]
            edge_cost_out[3 * g + k] = edge_cost_in[3 * f + k]
            seam_out[3 * g + k] = seam_in[3 * f + k]
