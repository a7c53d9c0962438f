"""Half-edges of borders and seams, as a list."""

import warp as wp

from warpqem.kernels.topology import next_corner

wp.set_module_options({"enable_backward": False})  # no gradients are taken


@wp.kernel
def mark_constrained(
    # in
    border_in: wp.array[wp.int32],
    seam_in: wp.array[wp.int32],
    # out
    constrained_out: wp.array[wp.int32],
    is_constrained_out: wp.array[wp.int32],
):
    """1 at border half-edges and 2 at those of seams; and 1 at both."""
    h = wp.tid()
    constrained = border_in[h] | 2 * seam_in[h]
    constrained_out[h] = constrained
    is_constrained_out[h] = wp.where(constrained != 0, 1, 0)


@wp.kernel
def list_constrained(
    # in
    corner_vertex_in: wp.array[wp.int32],
    constrained_in: wp.array[wp.int32],
    before_in: wp.array[wp.int32],
    # out
    edge_out: wp.array[wp.vec4i],
):
    """Half-edge, what it is, and its ends, ascending, as far as there is room.

    ``before_in`` counts those up to each half-edge, itself too.
    """
    h = wp.tid()
    if constrained_in[h] != 0 and before_in[h] <= edge_out.shape[0]:
        edge_out[before_in[h] - 1] = wp.vec4i(
            h, constrained_in[h], corner_vertex_in[h], corner_vertex_in[next_corner(h)]
        )
