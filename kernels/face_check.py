"""What faces refer to, before anything is made of them."""

import warp as wp

wp.set_module_options({"enable_backward": False})  # no gradients are taken


@wp.kernel
def mark_used_vertices(
    # in
    corner_vertex_in: wp.array[wp.int32],
    # in and out
    used: wp.array[wp.bool],
    is_unfit: wp.array[wp.bool],
):
    """Mark the vertices (V,) of faces; ``is_unfit`` (1,) is where one uses a vertex twice, or one that is none."""
    h = 3 * wp.tid()
    a = corner_vertex_in[h]
    b = corner_vertex_in[h + 1]
    c = corner_vertex_in[h + 2]
    vertex_count = used.shape[0]
    if wp.min(wp.min(a, b), c) < 0 or wp.max(wp.max(a, b), c) >= vertex_count or a == b or b == c or c == a:
        is_unfit[0] = True
    else:
        used[a] = True
        used[b] = True
        used[c] = True


@wp.kernel
def drop_unfit_faces(
    # in
    corner_vertex_in: wp.array[wp.int32],
    vertex_count: wp.int32,
    # out
    corner_vertex_out: wp.array[wp.int32],
):
    """The corners (3N,) of faces, -1 of those that use a vertex twice, or one that is none."""
    h = 3 * wp.tid()
    a = corner_vertex_in[h]
    b = corner_vertex_in[h + 1]
    c = corner_vertex_in[h + 2]
    is_unfit = wp.min(wp.min(a, b), c) < 0 or wp.max(wp.max(a, b), c) >= vertex_count or a == b or b == c or c == a
    corner_vertex_out[h] = wp.where(is_unfit, -1, a)
    corner_vertex_out[h + 1] = wp.where(is_unfit, -1, b)
    corner_vertex_out[h + 2] = wp.where(is_unfit, -1, c)
