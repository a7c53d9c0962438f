"""Placing, checking and committing the collapses of a round with many threads for each, as a GPU wants it.

One thread that walks a collapse's frames, faces and members waits for memory all the time: of a gallop's ordering on an
H100 four fifths went into that. Here each thread has a frame, a face or a few members of a collapse. What they find is
laid down where no other thread writes (selected collapses share no vertex, and no face of their one-rings), and one
thread adds it up in the order of the kernels with a thread a collapse: the results are theirs, to the bit.
"""

from typing import Any

import warp as wp

from warpqem.kernels.collapse import commit_collapse, ends_of, merge_frame
from warpqem.kernels.edge_cost import anchor_of_terms, anchor_terms, forced_anchor, merged_position
from warpqem.kernels.lanes import POINTS_ARRAY, lane_kernel
from warpqem.kernels.legality import (
    gap_error,
    joins_rings,
    keeps_manifold_ends,
    opposite_vertices,
    settle_collapse,
    turns_over,
)
from warpqem.kernels.member_distance import (
    CollapsePose,
    area_of_member,
    face_area,
    face_middle,
    first_pose,
    gap_of_member,
    key_point,
    longest_pose,
    nearest_member,
)
from warpqem.kernels.mesh_state import (
    INFINITE_BITS,
    KEY_FRAMES,
    AnyKeyFrames,
    CollapseLog,
    CostModel,
    MeshState,
    degree,
)
from warpqem.kernels.quadric import NO_PLANE
from warpqem.kernels.topology import OPEN, half_edge_target, previous_corner
from warpqem.kernels.work import EdgeList, Work

# Threads that share the faces and members of a collapse: most have ten faces left around their ends, each with members
# of four vertices to look at. Fewer where the launch has no more: the passes that take a million faces to a tenth take
# an H100 57.9, 56.9 and 61.1 ms with 16, 32 and 64, and those of a gallop of 17000 take 29.1, 26.6 and 24.3 ms.
MIN_SLOTS = wp.constant(wp.int32(16))
MAX_SLOTS = wp.constant(wp.int32(128))


@wp.struct
class CheckNotes:
    """What the threads of a collapse have found (V vertices, N faces)."""

    refused: wp.array[wp.int32]  # a collapse each: the last round that refused the one at this place in the list
    member_gap: wp.array[wp.float32]  # (V,) area times squared distance of a member from the faces left
    face_area: wp.array2d[wp.float32]  # (2, 3N) at the corner that moves: area of a face left, in both poses
    face_distance: wp.array2d[wp.int32]  # (2, 3N) there: squared distance of its middle from members, bits of a float


@wp.func
def selected_ends(state: MeshState, selected: EdgeList, i: wp.int32):
    """Where a selected half-edge begins and ends."""
    h = selected.half_edge[i]
    return state.corner_vertex[h], half_edge_target(state.corner_vertex, h)


@lane_kernel(frames=KEY_FRAMES, target_out=POINTS_ARRAY)
def measure_anchors(
    # in
    frames: AnyKeyFrames,
    state: MeshState,
    selected: EdgeList,
    work: Work,
    # out
    target_out: Any,
):
    """The terms of the anchor of each selected edge in each block, in the first column of the rows of its target."""
    block_count = frames.position.shape[1]
    for item in range(wp.tid(), block_count * selected.count[0], work.thread_count):
        i = item // block_count
        t = item % block_count
        u, v = selected_ends(state, selected, i)
        slope, stiffness, regularisation = anchor_terms(frames, u, v, t)
        terms = target_out.dtype()
        terms[0, 0] = slope
        terms[1, 0] = stiffness
        terms[2, 0] = regularisation
        target_out[i, t] = terms


@lane_kernel(term_in=POINTS_ARRAY)
def sum_anchor_terms(
    # in
    state: MeshState,
    model: CostModel,
    selected: EdgeList,
    term_in: Any,
    work: Work,
    # out
    anchor_out: wp.array[wp.float32],
):
    """The anchor along each selected edge, of the terms of :func:`measure_anchors`."""
    for i in range(wp.tid(), selected.count[0], work.thread_count):
        u, v = selected_ends(state, selected, i)
        anchor = forced_anchor(state, u, v)
        if anchor < 0.0:
            slope = wp.float32(0.0)
            stiffness = wp.float32(0.0)
            regularisation = wp.float32(0.0)
            for t in range(term_in.shape[1]):
                terms = term_in[i, t]
                slope += terms[0, 0]
                stiffness += terms[1, 0]
                regularisation += terms[2, 0]
            anchor = anchor_of_terms(state, model, u, v, slope, stiffness, regularisation)
        anchor_out[i] = anchor


@lane_kernel(frames=KEY_FRAMES, target_out=POINTS_ARRAY)
def place_blocks(
    # in
    frames: AnyKeyFrames,
    state: MeshState,
    model: CostModel,
    selected: EdgeList,
    anchor_in: wp.array[wp.float32],
    work: Work,
    # out
    target_out: Any,
):
    """The merged vertex of each selected collapse in each block of key frames."""
    block_count = frames.position.shape[1]
    for item in range(wp.tid(), block_count * selected.count[0], work.thread_count):
        i = item // block_count
        t = item % block_count
        u, v = selected_ends(state, selected, i)
        target_out[i, t] = merged_position(state, frames, model, u, v, t, anchor_in[i])


@wp.func
def note_face(
    state: MeshState,
    frames: AnyKeyFrames,
    notes: CheckNotes,
    vertex: wp.int32,
    g: wp.int32,
    x: wp.int32,
    y: wp.int32,
    pose: CollapsePose,
):
    """Note the area of the face ``apex x y``, and how far its middle is from the members of one of its vertices.

    The nearest member of all counts: a least is the same in any order of the threads.
    """
    q = key_point(frames.position, x, pose.frame)
    r = key_point(frames.position, y, pose.frame)
    row = wp.where(pose.frame == 0, 0, 1)
    middle = face_middle(pose.apex, q, r)
    squared = wp.max(nearest_member(state, frames, vertex, pose, middle, wp.float32(wp.inf)), 0.0)
    # The bits of numbers that are not negative are in their order.
    wp.atomic_min(notes.face_distance, row, g, wp.cast(squared, wp.int32))
    notes.face_area[row, g] = face_area(pose.apex, q, r)


@wp.func
def check_faces(
    state: MeshState,
    frames: AnyKeyFrames,
    h: wp.int32,
    target: Any,
    i: wp.int32,
    first: CollapsePose,
    longest: CollapsePose,
    flip_tolerance: wp.int32,
    slot: wp.int32,
    slot_count: wp.int32,
    notes: CheckNotes,
) -> wp.bool:
    """Whether a face of a slot, of those around the ends of half-edge ``h``, breaks a rule; notes of those that stay.

    Each face is there four times, once for each vertex whose members it is compared with; two of these times it is
    checked too.
    """
    u = state.corner_vertex[h]
    v = half_edge_target(state.corner_vertex, h)
    own = degree(state, u)
    face_count = own + degree(state, v)
    breaks = wp.bool(False)
    for item in range(slot, 4 * face_count, slot_count):
        turn = item // face_count
        j = item % face_count
        at_u = j < own
        b = wp.where(at_u, v, u)
        g = state.adjacency.corner[wp.where(at_u, state.adjacency.start[u] + j, state.adjacency.start[v] + j - own)]
        x = half_edge_target(state.corner_vertex, g)
        y = state.corner_vertex[previous_corner(g)]
        if turn == 1 and not at_u:
            left, right = opposite_vertices(state, h)
            if joins_rings(state, u, g, left, right, (state.vertex_flags[v] & OPEN) != 0):
                breaks = True
        if x != b and y != b:
            if turn == 0 and turns_over(state, frames, g, target, i, flip_tolerance):
                breaks = True
            vertex = wp.where(turn == 0, u, wp.where(turn == 1, v, wp.where(turn == 2, x, y)))
            note_face(state, frames, notes, vertex, g, x, y, first)
            if longest.frame > 0:
                note_face(state, frames, notes, vertex, g, x, y, longest)
    return breaks


@wp.func
def slots_of(selected: EdgeList, work: Work) -> wp.int32:
    """Threads that share a collapse. What they find does not depend on how many there are."""
    return wp.clamp(work.thread_count // wp.max(selected.count[0], 1), MIN_SLOTS, MAX_SLOTS)


@lane_kernel(frames=KEY_FRAMES, target_in=POINTS_ARRAY)
def check_slots(
    # in
    frames: AnyKeyFrames,
    state: MeshState,
    model: CostModel,
    selected: EdgeList,
    target_in: Any,
    flip_tolerance: wp.int32,
    round_count_in: wp.array[wp.int32],
    work: Work,
    # in and out
    notes: CheckNotes,
):
    """What the rules and distances of each selected collapse come to at its faces and members, a slot of them a thread.

    Threads that find a collapse illegal write the same.
    """
    slot_count = slots_of(selected, work)
    for item in range(wp.tid(), slot_count * selected.count[0], work.thread_count):
        i = item // slot_count
        slot = item % slot_count
        h = selected.half_edge[i]
        u = state.corner_vertex[h]
        v = half_edge_target(state.corner_vertex, h)
        first = first_pose(target_in, i)
        longest = longest_pose(frames, model, u, v)
        longest.apex = key_point(target_in, i, longest.frame)
        if check_faces(state, frames, h, target_in, i, first, longest, flip_tolerance, slot, slot_count, notes):
            notes.refused[i] = round_count_in[0]
        k = wp.int32(0)
        for side in range(2):
            m = wp.where(side == 0, u, v)
            while m >= 0:
                if k % slot_count == slot:
                    notes.member_gap[m] = gap_of_member(state, frames, u, v, first, longest, m)
                k += 1
                m = state.members.following[m]


@wp.func
def noted_member_gap(state: MeshState, notes: CheckNotes, u: wp.int32, v: wp.int32, longest: CollapsePose) -> wp.vec2:
    """What :func:`member_gap` measures, of the notes."""
    gap = wp.float32(0.0)
    area = wp.float32(0.0)
    for side in range(2):
        m = wp.where(side == 0, u, v)
        while m >= 0:
            gap += notes.member_gap[m]
            area += area_of_member(state, longest, m)
            m = state.members.following[m]
    return wp.vec2(gap, area)


@wp.func
def take_face_gap(state: MeshState, notes: CheckNotes, u: wp.int32, v: wp.int32, longest: CollapsePose) -> wp.float32:
    """What :func:`face_gap` measures, of the notes, which are cleared."""
    gap = wp.float32(0.0)
    for side in range(2):
        a = wp.where(side == 0, u, v)
        b = wp.where(side == 0, v, u)
        for i in range(state.adjacency.start[a], state.adjacency.end[a]):
            g = state.adjacency.corner[i]
            if half_edge_target(state.corner_vertex, g) != b and state.corner_vertex[previous_corner(g)] != b:
                here = notes.face_area[0, g] * wp.cast(notes.face_distance[0, g], wp.float32)
                notes.face_distance[0, g] = INFINITE_BITS
                if longest.frame > 0:
                    there = notes.face_area[1, g] * wp.cast(notes.face_distance[1, g], wp.float32)
                    notes.face_distance[1, g] = INFINITE_BITS
                    here = wp.max(here, longest.share * there)
                gap += here
    return gap


@lane_kernel(frames=KEY_FRAMES)
def settle_collapses(
    # in and out
    state: MeshState,
    notes: CheckNotes,
    # in
    frames: AnyKeyFrames,
    model: CostModel,
    selected: EdgeList,
    round_count_in: wp.array[wp.int32],
    work: Work,
    # out
    faces_removed_out: wp.array[wp.int32],
    error_out: wp.array[wp.float32],
):
    """What :func:`check_collapses` gives, of the notes of :func:`check_slots`."""
    for i in range(wp.tid(), selected.count[0], work.thread_count):
        h = selected.half_edge[i]
        legal = notes.refused[i] != round_count_in[0] and keeps_manifold_ends(state, h)
        u = state.corner_vertex[h]
        v = half_edge_target(state.corner_vertex, h)
        longest = longest_pose(frames, model, u, v)
        back = take_face_gap(state, notes, u, v, longest)
        gap = wp.vec2(0.0, 0.0)
        if legal:
            gap = noted_member_gap(state, notes, u, v, longest)
            error_out[i] = gap_error(gap)
        faces_removed_out[i] = settle_collapse(state, frames, model, h, legal, gap, back)


@lane_kernel(frames=KEY_FRAMES, target=POINTS_ARRAY)
def merge_blocks(
    # in
    state: MeshState,
    selected: EdgeList,
    faces_removed_in: wp.array[wp.int32],
    work: Work,
    # in and out
    frames: AnyKeyFrames,
    target: Any,
):
    """Move the vertices of the legal collapses in each block; what the error sums comes to lie where the target was."""
    block_count = frames.position.shape[1]
    for item in range(wp.tid(), block_count * selected.count[0], work.thread_count):
        i = item // block_count
        t = item % block_count
        if faces_removed_in[i] > 0:
            u, v = ends_of(state, selected.half_edge[i])
            error, area = merge_frame(state, frames, u, v, target[i, t], t)
            terms = target.dtype()
            terms[0, 0] = error
            terms[1, 0] = area
            target[i, t] = terms


@lane_kernel(frames=KEY_FRAMES, term_in=POINTS_ARRAY)
def commit_merged(
    # in and out
    state: MeshState,
    # in
    frames: AnyKeyFrames,
    selected: EdgeList,
    faces_removed_in: wp.array[wp.int32],
    term_in: Any,
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
    """Apply and log the legal collapses, whose vertices have moved: the rest of :func:`commit_collapses`."""
    for i in range(wp.tid(), selected.count[0], work.thread_count):
        if faces_removed_in[i] > 0:
            h = selected.half_edge[i]
            u, _v = ends_of(state, h)
            error = wp.float32(0.0)
            area = wp.float32(0.0)
            for t in range(term_in.shape[1]):
                terms = term_in[i, t]
                error += terms[0, 0]
                area += terms[1, 0]
            lead = frames.position[u, 0]
            slot = commit_collapse(state, h, anchor_in[i], lead, pass_number_in[0], 0, mask, log, log_slot, pool_slot)
            log.faces_removed[slot] = faces_removed_in[i]
            log.error[slot] = wp.max(error_in[i], error / wp.max(area, NO_PLANE))
