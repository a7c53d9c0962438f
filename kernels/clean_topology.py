"""Whether a topology is one that decimation can work on."""

import warp as wp

from warpqem.kernels.topology import NON_MANIFOLD, VertexAdjacency, half_edge_target, previous_corner

wp.set_module_options({"enable_backward": False})  # no gradients are taken


@wp.kernel
def find_unclean_vertices(
    # in
    corner_vertex_in: wp.array[wp.int32],
    adjacency_in: VertexAdjacency,
    vertex_flags_in: wp.array[wp.int32],
    first_vertex: wp.int32,
    # out
    is_unclean_out: wp.array[wp.int32],
):
    """Set ``is_unclean_out`` (1,), zeroed before, where faces at a vertex are not one fan or have the same vertices.

    Two faces with the same vertices and one winding break a fan. Those with the other winding follow each other and
    close it, so that in a fan they are the only ones: both sides of a single triangle.
    """
    v = first_vertex + wp.tid()
    if (vertex_flags_in[v] & NON_MANIFOLD) != 0:
        is_unclean_out[0] = 1
    first = adjacency_in.start[v]
    if adjacency_in.end[v] - first == 2:
        g = adjacency_in.corner[first]
        h = adjacency_in.corner[first + 1]
        ahead = half_edge_target(corner_vertex_in, g) == corner_vertex_in[previous_corner(h)]
        behind = half_edge_target(corner_vertex_in, h) == corner_vertex_in[previous_corner(g)]
        if ahead and behind:
            is_unclean_out[0] = 1


@wp.kernel
def count_non_manifold(
    # in
    vertex_flags_in: wp.array[wp.int32],
    # in and out
    count: wp.array[wp.int32],
):
    """Count the vertices whose faces are not one fan (from zero)."""
    if (vertex_flags_in[wp.tid()] & NON_MANIFOLD) != 0:
        wp.atomic_add(count, 0, 1)
