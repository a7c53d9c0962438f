"""What vertices stand for before the first collapse: themselves, with their share of the faces around."""

from typing import Any

import warp as wp

from warpqem.kernels.lanes import POINTS_ARRAY, lane_cross, lane_dot, lane_kernel
from warpqem.kernels.mesh_state import Members
from warpqem.kernels.topology import VertexAdjacency

wp.set_module_options({"enable_backward": False})  # no gradients are taken


@wp.kernel
def begin_members(
    # out
    members: Members,
):
    """Each vertex is the only one of its list."""
    v = wp.tid()
    members.following[v] = -1
    members.last[v] = v


@lane_kernel(position_in=POINTS_ARRAY)
def measure_faces(
    # in
    position_in: Any,
    corner_vertex_in: wp.array[wp.int32],
    # out
    size_out: wp.array2d[wp.float64],
    longest_out: wp.array2d[wp.float32],
):
    """A third of the area of each face (N, 2), its longest edge squared: in the first key frame, and sums of all."""
    f = wp.tid()
    if corner_vertex_in[3 * f] < 0:
        # A face that was left out, which no vertex has.
        return
    sum_of_sizes = wp.float64(0.0)
    sum_of_longest = wp.float32(0.0)
    for t in range(position_in.shape[1]):
        a = position_in[corner_vertex_in[3 * f], t]
        b = position_in[corner_vertex_in[3 * f + 1], t]
        c = position_in[corner_vertex_in[3 * f + 2], t]
        cross = lane_cross(b - a, c - a)
        doubled = lane_dot(cross, cross)
        longest = wp.max(wp.max(lane_dot(a - b, a - b), lane_dot(b - c, b - c)), lane_dot(c - a, c - a))
        # All roots at once, before the sums that take one lane after another.
        size = type(doubled)()
        for k in range(len(size)):
            size[k] = wp.sqrt(doubled[k]) / 6.0
        # Frames that fill up the last block are points without an extent.
        for k in range(len(size)):
            sum_of_sizes += wp.float64(size[k])
            sum_of_longest += longest[k]
        if t == 0:
            size_out[f, 0] = wp.float64(size[0])
            longest_out[f, 0] = longest[0]
    size_out[f, 1] = sum_of_sizes
    longest_out[f, 1] = sum_of_longest


@lane_kernel(position_in=POINTS_ARRAY)
def measure_members(
    # in
    position_in: Any,
    key_count: wp.int32,
    size_in: wp.array2d[wp.float64],
    longest_in: wp.array2d[wp.float32],
    adjacency_in: VertexAdjacency,
    first_vertex: wp.int32,
    # in and out
    members: Members,
):
    """A third of the area of the faces around each vertex, in the order of their corners, and how far they reach.

    In the first key frame, and the means of all. No point of a triangle is further from its nearest corner than its
    longest edge times 3^-0.5, but of obtuse ones.
    """
    v = first_vertex + wp.tid()
    area = wp.float64(0.0)
    mean_area = wp.float64(0.0)
    reach = wp.float32(0.0)
    mean_reach = wp.float32(0.0)
    for i in range(adjacency_in.start[v], adjacency_in.end[v]):
        f = adjacency_in.corner[i] // 3
        area += size_in[f, 0]
        mean_area += size_in[f, 1]
        reach = wp.max(reach, longest_in[f, 0] / 3.0)
        mean_reach = wp.max(mean_reach, longest_in[f, 1] / (3.0 * wp.float32(key_count)))
    own = position_in[v, 0]
    members.first_point[v] = wp.vec3(own[0, 0], own[1, 0], own[2, 0])
    members.area[0, v] = wp.float32(area)
    members.area[1, v] = wp.float32(mean_area / wp.float64(key_count))
    members.reach_squared[0, v] = reach
    members.reach_squared[1, v] = mean_reach
