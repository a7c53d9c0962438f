"""What vertices stand for before the first collapse: themselves, with their share of the faces around."""

from typing import Any

import warp as wp

from warpqem.kernels.lanes import POINTS_ARRAY, lane_kernel
from warpqem.kernels.mesh_state import Members
from warpqem.kernels.topology import VertexAdjacency

wp.set_module_options({"enable_backward": False})  # no gradients are taken


@lane_kernel(position_in=POINTS_ARRAY)
def begin_members(
    # in
    position_in: Any,
    # out
    members: Members,
):
    """Each vertex is the only one of its list, where it is in the first frame."""
    v = wp.tid()
    p = position_in[v, 0]
    members.position[v] = wp.vec3(p[0, 0], p[1, 0], p[2, 0])
    members.following[v] = -1
    members.last[v] = v


@wp.kernel
def measure_members(
    # in
    corner_vertex_in: wp.array[wp.int32],
    adjacency_in: VertexAdjacency,
    first_vertex: wp.int32,
    # in and out
    members: Members,
):
    """A third of the area of the faces around each vertex, in the order of their corners, and how far they reach.

    No point of a triangle is further from its nearest corner than its longest edge times 3^-0.5, but of obtuse ones.
    """
    v = first_vertex + wp.tid()
    area = wp.float64(0.0)
    reach = wp.float32(0.0)
    for i in range(adjacency_in.start[v], adjacency_in.end[v]):
        # From the face's first corner, so that its three vertices see the same area to the bit.
        h = 3 * (adjacency_in.corner[i] // 3)
        a = members.position[corner_vertex_in[h]]
        b = members.position[corner_vertex_in[h + 1]]
        c = members.position[corner_vertex_in[h + 2]]
        area += wp.float64(wp.length(wp.cross(b - a, c - a)) / 6.0)
        longest = wp.max(wp.max(wp.length_sq(a - b), wp.length_sq(b - c)), wp.length_sq(c - a))
        reach = wp.max(reach, longest / 3.0)
    members.area[v] = wp.float32(area)
    members.reach_squared[v] = reach
