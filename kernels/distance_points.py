"""Points of a moving mesh against some faces of another one, in many frames side by side: how far they are at most.

Looked at are the faces at some clusters of a simplified mesh, and those at the clusters next to these. Others may be
nearer, so that a distance found is no less than the real one. Faces whose edges become long need points between their
vertices, too. See :mod:`warpqem.kernels.lanes` for the layout.
"""

from typing import Any

import warp as wp

from warpqem.kernels.distance_pieces import lane_distance_squared, lane_foot_squared
from warpqem.kernels.lanes import POINTS_ARRAY, lane_dot, lane_kernel

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# A squared distance beyond all others.
FAR = wp.constant(wp.float32(1.0e30))
# Balls about triangles are looked at with so much more than single precision rounds squared distances by.
BALL_MARGIN = wp.constant(wp.float32(1.0001))
# To look for a face to begin with takes half the time of a look at the faces of such a list, one after another.
LONG_LIST = wp.constant(wp.int32(12))


@wp.struct
class Around:
    """The faces of a simplified mesh at each of its vertices, which are clusters."""

    start: wp.array[wp.int32]  # (C+1,)
    face: wp.array[wp.int32]
    vertex: wp.array[wp.int32]  # (3N',) of each corner


@wp.func
def list_length(cluster: wp.array[wp.int32], face_start: wp.array[wp.int32], k: wp.int32) -> wp.int32:
    """Faces at the ``k``-th cluster."""
    return face_start[cluster[k] + 1] - face_start[cluster[k]]


@wp.func
def is_next(
    around: Around,
    cluster: wp.array[wp.int32],
    first: wp.int32,
    last: wp.int32,
    k: wp.int32,
    place: wp.int32,
    other: wp.int32,
) -> wp.bool:
    """Whether a cluster is none of those from ``first`` to ``last``, and no earlier face at the ``k``-th one has it.

    ``place`` in ``around.face`` is that of the face that has it.
    """
    for known in range(first, last):
        if cluster[known] == other:
            return False
    for earlier in range(around.start[cluster[k]], place):
        for corner in range(3):
            if around.vertex[3 * around.face[earlier] + corner] == other:
                return False
    return True


@wp.func
def largest_of(x: Any) -> wp.float32:
    """The largest of numbers (width,). ``wp.max`` looks for what is no number, too: a third of the time of a look."""
    largest = x[0]
    for lane in range(1, len(x)):
        largest = wp.where(x[lane] > largest, x[lane], largest)
    return largest


@wp.func
def may_be_nearer(near: Any, point: Any, a: Any, b: Any, c: Any, within: wp.float32) -> wp.bool:
    """Whether a triangle may lower one of the squared distances of points that are above ``within``.

    It lies in the ball about its first corner that its other corners reach.
    """
    gain = lane_dot(point - a, point - a)
    ee = lane_dot(b - a, b - a)
    ff = lane_dot(c - a, c - a)
    for lane in range(len(near)):
        reach = wp.sqrt(wp.max(ee[lane], ff[lane])) + wp.sqrt(near[lane])
        gain[lane] = wp.where(near[lane] > within, BALL_MARGIN * reach * reach - gain[lane], -1.0)
    return largest_of(gain) >= 0.0


@wp.func
def nearer(near: Any, point: Any, a: Any, b: Any, c: Any, within: wp.float32):
    """The smaller ones of squared distances ``near`` and those of points from faces; within ``within``, no less."""
    ab = b - a
    ac = c - a
    found = lane_foot_squared(point - a, ab, ac)
    for lane in range(len(near)):
        near[lane] = wp.min(near[lane], found[lane])
    if largest_of(near) > within:
        found = lane_distance_squared(point - a, ab, ac)
        for lane in range(len(near)):
            near[lane] = wp.min(near[lane], found[lane])
    return near


@lane_kernel(own=POINTS_ARRAY, other=POINTS_ARRAY)
def distances_of_points(
    # in
    own: Any,
    other: Any,
    other_vertex: wp.array[wp.int32],
    point: wp.array[wp.int32],
    row: wp.array[wp.int32],
    cluster_start: wp.array[wp.int32],
    cluster: wp.array[wp.int32],
    face_start: wp.array[wp.int32],
    face: wp.array[wp.int32],
    around: Around,
    squared: wp.array[wp.float32],
    shares: wp.int32,
    # in and out
    nearest: wp.array[wp.int32],
    furthest: wp.array[wp.float32],
):
    """Raise ``furthest`` (n,) to the largest squared distance of each point from its faces, in all frames.

    Each of ``shares`` threads of a point has some of the blocks, one after another. The faces are those at the clusters
    of row ``row`` (n,): lists ``face_start`` (C+1,), ``face`` of lists ``cluster_start`` (R+1,), ``cluster``; then
    those at the clusters next to these, see :class:`Around`. Once a point is within its ``squared`` (n,) in all frames
    of a block, no further faces are looked at there, and the next block begins with the last one that was nearer: what
    is near in some frames is near in others. ``nearest`` (n,) says where a single thread of a point begins, and then
    where it ended; -1 for nowhere: then long lists are looked through for faces whose middles are near in one frame.
    Points of a negative ``squared`` are not looked at.
    """
    i, share = wp.tid()
    if squared[i] < 0.0:
        return
    first = cluster_start[row[i]]
    last = cluster_start[row[i] + 1]
    begin = wp.int32(-1)
    if shares == 1:
        begin = nearest[i]
    is_long = wp.bool(False)
    if begin < 0:
        count = wp.int32(0)
        for k in range(first, last):
            count += list_length(cluster, face_start, k)
        is_long = count > LONG_LIST
    furthest_of_all = wp.float32(0.0)
    within = squared[i]
    for block in range(share * own.shape[1] / shares, (share + 1) * own.shape[1] / shares):
        p = own[point[i], block]
        near = 0.0 * p[0]
        for lane in range(len(near)):
            near[lane] = FAR
        here = wp.float32(FAR)
        if begin >= 0:
            a = other[other_vertex[3 * begin], block]
            b = other[other_vertex[3 * begin + 1], block]
            c = other[other_vertex[3 * begin + 2], block]
            near = nearer(near, p, a, b, c, within)
            here = largest_of(near)
        if here > within and is_long:
            least = wp.float32(FAR)
            k = first
            while k < last and here > within:
                j = face_start[cluster[k]]
                end = face_start[cluster[k] + 1]
                while j < end and here > within:
                    u = other_vertex[3 * face[j]]
                    v = other_vertex[3 * face[j] + 1]
                    w = other_vertex[3 * face[j] + 2]
                    middle = wp.vec3()
                    for axis in range(3):
                        corners = other[u, block][axis, 0] + other[v, block][axis, 0] + other[w, block][axis, 0]
                        middle[axis] = corners - 3.0 * p[axis, 0]
                    if wp.length_sq(middle) < least:
                        least = wp.length_sq(middle)
                        begin = face[j]
                        near = nearer(near, p, other[u, block], other[v, block], other[w, block], within)
                        here = largest_of(near)
                    j += 1
                k += 1
        k = first
        while k < last and here > within:
            j = face_start[cluster[k]]
            end = face_start[cluster[k] + 1]
            while j < end and here > within:
                a = other[other_vertex[3 * face[j]], block]
                b = other[other_vertex[3 * face[j] + 1], block]
                c = other[other_vertex[3 * face[j] + 2], block]
                if here >= FAR or may_be_nearer(near, p, a, b, c, within):
                    near = nearer(near, p, a, b, c, within)
                    before = here
                    here = largest_of(near)
                    if here < before:
                        begin = face[j]
                j += 1
            k += 1
        if here > within:
            for k in range(first, last):
                for join in range(around.start[cluster[k]], around.start[cluster[k] + 1]):
                    for way in range(3):
                        neighbour = around.vertex[3 * around.face[join] + way]
                        if here > within and is_next(around, cluster, first, last, k, join, neighbour):
                            for further in range(face_start[neighbour], face_start[neighbour + 1]):
                                if here > within:
                                    corner = 3 * face[further]
                                    a = other[other_vertex[corner], block]
                                    b = other[other_vertex[corner + 1], block]
                                    c = other[other_vertex[corner + 2], block]
                                    if may_be_nearer(near, p, a, b, c, within):
                                        near = nearer(near, p, a, b, c, within)
                                        before = here
                                        here = largest_of(near)
                                        if here < before:
                                            begin = face[further]
        furthest_of_all = wp.max(furthest_of_all, here)
    if shares == 1:
        nearest[i] = begin
    wp.atomic_max(furthest, i, furthest_of_all)


@lane_kernel(position_in=POINTS_ARRAY, point_out=POINTS_ARRAY)
def points_of_faces(
    # in
    position_in: Any,
    corner_vertex_in: wp.array[wp.int32],
    weights_in: wp.array[wp.vec3],
    within_in: wp.array2d[wp.float32],
    # out
    point_out: Any,
):
    """Points of faces, by S weights of their corners (3n,): (n, S B), the blocks of one point after another.

    Those of a negative ``within_in`` (n, S) are left out.
    """
    i, sample, block = wp.tid()
    if within_in[i, sample] < 0.0:
        return
    weights = weights_in[sample]
    point = weights[0] * position_in[corner_vertex_in[3 * i], block]
    point += weights[1] * position_in[corner_vertex_in[3 * i + 1], block]
    place = sample * position_in.shape[1] + block
    point_out[i, place] = point + weights[2] * position_in[corner_vertex_in[3 * i + 2], block]


@lane_kernel(blocks=POINTS_ARRAY)
def scale_frames(
    # in
    scale_in: wp.array[wp.float32],
    # in and out
    blocks: Any,
):
    """Multiply points (V, B) of each frame by its factor (F,)."""
    v, b = wp.tid()
    block = blocks[v, b]
    width = len(block[0])
    for k in range(width):
        t = b * width + k
        if t < scale_in.shape[0]:
            block[0, k] = scale_in[t] * block[0, k]
            block[1, k] = scale_in[t] * block[1, k]
            block[2, k] = scale_in[t] * block[2, k]
    blocks[v, b] = block


@lane_kernel(before_in=POINTS_ARRAY, now_in=POINTS_ARRAY)
def largest_steps(
    # in
    before_in: Any,
    now_in: Any,
    component_in: wp.array[wp.int32],
    # in and out
    step: wp.array[wp.float32],
):
    """Raise ``step`` of each component to how far one of its vertices (V,) has gone at most in any frame."""
    v = wp.tid()
    longest = wp.float32(0.0)
    for block in range(before_in.shape[1]):
        way = now_in[v, block] - before_in[v, block]
        longest = wp.max(longest, largest_of(lane_dot(way, way)))
    if longest > 0.0:
        wp.atomic_max(step, component_in[v], wp.sqrt(longest))


@lane_kernel(position_in=POINTS_ARRAY)
def longest_edges(
    # in
    position_in: Any,
    corner_vertex_in: wp.array[wp.int32],
    # out
    squared_out: wp.array[wp.float32],
):
    """The squared length of the longest edge of each face in any frame: (N,)."""
    i = wp.tid()
    longest = wp.float32(0.0)
    for block in range(position_in.shape[1]):
        for k in range(3):
            a = position_in[corner_vertex_in[3 * i + k], block]
            edge = position_in[corner_vertex_in[3 * i + (k + 1) % 3], block] - a
            longest = wp.max(longest, wp.max(lane_dot(edge, edge)))
    squared_out[i] = longest


# Loops over corners and faces stay loops: unrolled, they take several times as long to compile and run no faster.
for _kernel in (*distances_of_points.values(), *longest_edges.values()):
    wp.set_module_options({"max_unroll": 1}, _kernel.module)
del _kernel
