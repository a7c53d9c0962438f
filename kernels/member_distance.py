"""How far the input vertices that a collapse merges would be from the faces that it leaves around their vertex.

Quadrics measure distances from planes, which go on for ever: a tip that is cut off stays near the planes of its sides.
This measures distances from faces, at the members of both clusters; and the other way round how far the faces left are
from the members, as faces that span the hole of a ring leave no member behind. It takes a walk over members and faces,
so it is done for the edges that are about to collapse, not for all, and in the first key frame; where an edge is much
longer in another one, also there.
"""

from typing import Any

import warp as wp

from warpqem.kernels.closest_point import closest_barycentric, offset_squared
from warpqem.kernels.lanes import POINTS, WIDE, lane_dot, lane_sum
from warpqem.kernels.mesh_state import AnyKeyFrames, CostModel, MeshState
from warpqem.kernels.topology import half_edge_target, previous_corner

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# An edge is much longer in a frame where its squared length is so many times that in the first one. Distances in the
# longest frame alone, or in frames by turns, leave the largest of 49 cells 3 % worse or equal: in the first one, of a
# rest pose, most of what stands out does.
MUCH_LONGER = wp.constant(wp.float32(4.0))


# Members that are looked at side by side: floats in a 256-bit register.
MEMBER_WIDTH = wp.constant(WIDE)
MemberPoints = POINTS[WIDE]
MemberFloats = wp.types.vector(length=WIDE, dtype=wp.float32)
MemberLanes = wp.types.vector(length=WIDE, dtype=wp.int32)


@wp.struct
class CollapsePose:
    """A key frame in which distances of a collapse are measured; the first is there always, no other one is frame 0."""

    frame: wp.int32
    share: wp.float32  # what part of squared lengths there the mean over the key frames has; 1 in the first
    apex: wp.vec3  # where both ends go


@wp.func
def key_point(position: Any, v: wp.int32, frame: wp.int32) -> wp.vec3:
    """The point of ``v`` in a key frame, of blocks (V, B)."""
    width = len(position[v, 0][0])
    block = position[v, frame // width]
    lane = frame % width
    return wp.vec3(block[0, lane], block[1, lane], block[2, lane])


@wp.func
def first_pose(target: Any, i: wp.int32) -> CollapsePose:
    """The pose of the first frame, of the collapse that goes to row ``i`` of ``target`` (S, B)."""
    pose = CollapsePose()
    pose.share = 1.0
    pose.apex = key_point(target, i, 0)
    return pose


@wp.func
def longest_pose(frames: AnyKeyFrames, model: CostModel, u: wp.int32, v: wp.int32) -> CollapsePose:
    """The pose in which an edge is longest, where that is much longer than in the first; without its apex.

    What grows out of a surface later is nowhere to be seen in the first frame. Squared distances are taken to go with
    the squared lengths of the edge.
    """
    found = CollapsePose()
    longest = MUCH_LONGER * wp.length_sq(key_point(frames.position, v, 0) - key_point(frames.position, u, 0))
    total = wp.float32(0.0)
    for t in range(frames.position.shape[1]):
        d = frames.position[v, t] - frames.position[u, t]
        length = lane_dot(d, d)
        total += lane_sum(length)
        if wp.max(length) > longest:
            for k in range(len(length)):
                if length[k] > longest:
                    longest = length[k]
                    found.frame = t * len(length) + k
    if found.frame > 0:
        found.share = total / (model.key_count * longest)
    return found


@wp.func
def member_point(state: MeshState, frames: AnyKeyFrames, m: wp.int32, pose: CollapsePose) -> wp.vec3:
    """Where a member is in a pose."""
    if pose.frame == 0:
        return state.members.first_point[m]
    return key_point(frames.input, m, pose.frame)


@wp.func
def ring_distance_squared(
    state: MeshState, frames: AnyKeyFrames, u: wp.int32, v: wp.int32, pose: CollapsePose, p: wp.vec3
) -> wp.float32:
    """Squared distance of ``p`` from the faces around ``u`` and ``v`` once both have collapsed, in a pose."""
    best = wp.length_sq(p - pose.apex)
    for side in range(2):
        a = wp.where(side == 0, u, v)
        b = wp.where(side == 0, v, u)
        for i in range(state.adjacency.start[a], state.adjacency.end[a]):
            h = state.adjacency.corner[i]
            x = half_edge_target(state.corner_vertex, h)
            y = state.corner_vertex[previous_corner(h)]
            if x != b and y != b:
                q = key_point(frames.position, x, pose.frame)
                r = key_point(frames.position, y, pose.frame)
                best = wp.min(best, offset_squared(p, pose.apex, q, r, closest_barycentric(p, pose.apex, q, r)))
    return best


@wp.func
def gap_of_member(
    state: MeshState,
    frames: AnyKeyFrames,
    u: wp.int32,
    v: wp.int32,
    first: CollapsePose,
    longest: CollapsePose,
    m: wp.int32,
) -> wp.float32:
    """Area times squared distance of a member of ``u`` or ``v``: the most of what it is in both poses."""
    distance = ring_distance_squared(state, frames, u, v, first, state.members.first_point[m])
    gap = state.members.area[0, m] * distance
    if longest.frame > 0:
        distance = ring_distance_squared(state, frames, u, v, longest, key_point(frames.input, m, longest.frame))
        # The mean area is the one there times the share.
        gap = wp.max(gap, state.members.area[1, m] * distance)
    return gap


@wp.func
def area_of_member(state: MeshState, longest: CollapsePose, m: wp.int32) -> wp.float32:
    """The area that goes with :func:`gap_of_member`: what is small in the first frame counts as it is in the other."""
    area = state.members.area[0, m]
    if longest.frame > 0:
        area = wp.max(area, state.members.area[1, m] / longest.share)
    return area


@wp.func
def lower_to_face(near: Any, points: Any, a: wp.vec3, b: wp.vec3, c: wp.vec3):
    """The smaller ones of squared distances ``near`` (width,) and those of points (3, width) from triangle abc.

    What :func:`offset_squared` gives at :func:`closest_barycentric`, for points side by side: what belongs to the
    triangle is worked out once, and no point waits for another one's branch.
    """
    ab = b - a
    ac = c - a
    bc = c - b
    ca = a - c
    ab_squared = wp.dot(ab, ab)
    bc_squared = wp.dot(bc, bc)
    ca_squared = wp.dot(ca, ca)
    normal = wp.cross(ab, ac)
    normal_squared = wp.dot(normal, normal)
    has_area = normal_squared > 0.0
    ab_length = wp.where(ab_squared > 0.0, ab_squared, 1.0)
    bc_length = wp.where(bc_squared > 0.0, bc_squared, 1.0)
    ca_length = wp.where(ca_squared > 0.0, ca_squared, 1.0)
    area_length = wp.where(has_area, normal_squared, 1.0)
    for k in range(len(near)):
        p = wp.vec3(points[0, k], points[1, k], points[2, k])
        ap = p - a
        t = wp.clamp(wp.dot(ap, ab) / ab_length, 0.0, 1.0)
        r = ap - t * ab
        best = wp.dot(r, r)
        t = wp.clamp(wp.dot(p - b, bc) / bc_length, 0.0, 1.0)
        r = ap - (1.0 - t) * ab - t * ac
        best = wp.min(best, wp.dot(r, r))
        t = wp.clamp(wp.dot(p - c, ca) / ca_length, 0.0, 1.0)
        r = ap - (1.0 - t) * ac
        best = wp.min(best, wp.dot(r, r))
        v = wp.dot(wp.cross(ap, ac), normal) / area_length
        w = wp.dot(wp.cross(ab, ap), normal) / area_length
        r = ap - v * ab - w * ac
        inside = has_area and v >= 0.0 and w >= 0.0 and v + w <= 1.0
        best = wp.where(inside, wp.min(best, wp.dot(r, r)), best)
        near[k] = wp.min(near[k], best)
    return near


@wp.func
def ring_distances_squared(
    state: MeshState, frames: AnyKeyFrames, u: wp.int32, v: wp.int32, pose: CollapsePose, member: MemberLanes
):
    """What :func:`ring_distance_squared` gives for members side by side."""
    points = MemberPoints()
    near = MemberFloats()
    for k in range(MEMBER_WIDTH):
        p = member_point(state, frames, member[k], pose)
        points[0, k] = p[0]
        points[1, k] = p[1]
        points[2, k] = p[2]
        near[k] = wp.length_sq(p - pose.apex)
    for side in range(2):
        a = wp.where(side == 0, u, v)
        b = wp.where(side == 0, v, u)
        for i in range(state.adjacency.start[a], state.adjacency.end[a]):
            h = state.adjacency.corner[i]
            x = half_edge_target(state.corner_vertex, h)
            y = state.corner_vertex[previous_corner(h)]
            if x != b and y != b:
                q = key_point(frames.position, x, pose.frame)
                r = key_point(frames.position, y, pose.frame)
                near = lower_to_face(near, points, pose.apex, q, r)
    return near


@wp.func
def member_gap(
    state: MeshState, frames: AnyKeyFrames, u: wp.int32, v: wp.int32, first: CollapsePose, longest: CollapsePose
) -> wp.vec2:
    """Sum over the members of ``u`` and ``v`` of area times squared distance, and of their areas.

    Members are looked at side by side. What :func:`gap_of_member` gives for each, added up one after another.
    """
    gap = wp.float32(0.0)
    area = wp.float32(0.0)
    m = u
    on_second = wp.bool(False)
    while m >= 0:
        member = MemberLanes()
        count = wp.int32(0)
        while m >= 0 and count < MEMBER_WIDTH:
            member[count] = m
            count += 1
            m = state.members.following[m]
            if m < 0 and not on_second:
                m = v
                on_second = True
        for k in range(MEMBER_WIDTH):
            if k >= count:
                member[k] = member[0]
        near = ring_distances_squared(state, frames, u, v, first, member)
        far_off = MemberFloats()
        if longest.frame > 0:
            far_off = ring_distances_squared(state, frames, u, v, longest, member)
        for k in range(MEMBER_WIDTH):
            if k < count:
                here = state.members.area[0, member[k]] * near[k]
                if longest.frame > 0:
                    # The mean area is the one there times the share.
                    here = wp.max(here, state.members.area[1, member[k]] * far_off[k])
                gap += here
                area += area_of_member(state, longest, member[k])
    return wp.vec2(gap, area)


@wp.func
def nearest_member(
    state: MeshState, frames: AnyKeyFrames, vertex: wp.int32, pose: CollapsePose, p: wp.vec3, best: wp.float32
) -> wp.float32:
    """The least of ``best`` and the squared distances of ``p`` from the surface around the members of a vertex.

    Any value below zero stands for all: it says that ``p`` is on that surface.
    """
    least = best
    row = wp.where(pose.frame == 0, 0, 1)
    m = vertex
    while m >= 0 and least > 0.0:
        squared = wp.length_sq(p - member_point(state, frames, m, pose))
        least = wp.min(least, squared - state.members.reach_squared[row, m] / pose.share)
        m = state.members.following[m]
    return least


@wp.func
def face_area(a: wp.vec3, b: wp.vec3, c: wp.vec3) -> wp.float32:
    """Area of a face."""
    return 0.5 * wp.length(wp.cross(b - a, c - a))


@wp.func
def face_middle(a: wp.vec3, b: wp.vec3, c: wp.vec3) -> wp.vec3:
    """The middle of a face."""
    return (a + b + c) / 3.0


@wp.func
def gap_of_face(
    state: MeshState,
    frames: AnyKeyFrames,
    u: wp.int32,
    v: wp.int32,
    x: wp.int32,
    y: wp.int32,
    pose: CollapsePose,
) -> wp.float32:
    """Area times squared distance of the middle of the face ``apex x y`` from the members of its corners."""
    q = key_point(frames.position, x, pose.frame)
    r = key_point(frames.position, y, pose.frame)
    middle = face_middle(pose.apex, q, r)
    squared = nearest_member(state, frames, x, pose, middle, wp.float32(wp.inf))
    squared = nearest_member(state, frames, y, pose, middle, squared)
    squared = nearest_member(state, frames, u, pose, middle, squared)
    squared = nearest_member(state, frames, v, pose, middle, squared)
    if squared <= 0.0:
        return 0.0
    return face_area(pose.apex, q, r) * squared


@wp.func
def face_gap(
    state: MeshState, frames: AnyKeyFrames, u: wp.int32, v: wp.int32, first: CollapsePose, longest: CollapsePose
) -> wp.float32:
    """Sum over the faces around ``u`` and ``v``, once both have collapsed, of area times squared distance of the middle
    from the members of the corners, as far as it is beyond what these reach; the most of both poses.
    """
    gap = wp.float32(0.0)
    for side in range(2):
        a = wp.where(side == 0, u, v)
        b = wp.where(side == 0, v, u)
        for i in range(state.adjacency.start[a], state.adjacency.end[a]):
            h = state.adjacency.corner[i]
            x = half_edge_target(state.corner_vertex, h)
            y = state.corner_vertex[previous_corner(h)]
            if x != b and y != b:
                here = gap_of_face(state, frames, u, v, x, y, first)
                if longest.frame > 0:
                    here = wp.max(here, longest.share * gap_of_face(state, frames, u, v, x, y, longest))
                gap += here
    return gap


@wp.func
def join_members(state: MeshState, u: wp.int32, v: wp.int32):
    """Give the members of ``v`` to ``u``, behind its own."""
    state.members.following[state.members.last[u]] = v
    state.members.last[u] = state.members.last[v]
