"""Points of a moving mesh against some faces of another one, in many frames side by side: how far they are at most.

Faces that are not among those given may be nearer, so that a distance found is no less than the real one. Faces whose
edges become long need points between their vertices, too. See :mod:`warpqem.kernels.lanes` for the layout.
"""

from typing import Any

import warp as wp

from warpqem.kernels.distance_pieces import lane_distance_squared, lane_foot_squared
from warpqem.kernels.lanes import POINTS_ARRAY, lane_dot, lane_kernel

wp.set_module_options({"enable_backward": False})  # no gradients are taken


@lane_kernel(own=POINTS_ARRAY, other=POINTS_ARRAY)
def distances_of_points(
    # in
    own: Any,
    other: Any,
    other_vertex: wp.array[wp.int32],
    point: wp.array[wp.int32],
    row: wp.array[wp.int32],
    face_start: wp.array[wp.int32],
    face: wp.array[wp.int32],
    squared: wp.float32,
    # out
    furthest_out: wp.array[wp.float32],
):
    """The largest squared distance of each point (n,) from its faces, in all frames: (n,).

    The faces are those of row ``row`` (n,) of the lists ``face_start`` (R+1,), ``face``. Once a point is within
    ``squared`` in all frames of a block, no further faces are looked at there, and the next block begins with the last
    one: what is near in some frames is near in others.
    """
    i = wp.tid()
    first = face_start[row[i]]
    count = face_start[row[i] + 1] - first
    begin = wp.int32(0)
    furthest_of_all = wp.float32(0.0)
    for block in range(own.shape[1]):
        p = own[point[i], block]
        near = 0.0 * p[0]
        for lane in range(len(near)):
            near[lane] = wp.float32(1.0e30)
        furthest = wp.float32(1.0e30)
        place = begin
        looked = wp.int32(0)
        while looked < count and furthest > squared:
            begin = place
            corner = 3 * face[first + place]
            a = other[other_vertex[corner], block]
            ab = other[other_vertex[corner + 1], block] - a
            ac = other[other_vertex[corner + 2], block] - a
            found = lane_foot_squared(p - a, ab, ac)
            for lane in range(len(near)):
                near[lane] = wp.min(near[lane], found[lane])
            furthest = wp.max(near)
            if furthest > squared:
                found = lane_distance_squared(p - a, ab, ac)
                for lane in range(len(near)):
                    near[lane] = wp.min(near[lane], found[lane])
                furthest = wp.max(near)
            looked += 1
            place = wp.where(place + 1 < count, place + 1, 0)
        furthest_of_all = wp.max(furthest_of_all, furthest)
    furthest_out[i] = furthest_of_all


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
