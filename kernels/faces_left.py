"""The faces that collapses left, as a list."""

import warp as wp

wp.set_module_options({"enable_backward": False})  # no gradients are taken


@wp.kernel
def mark_faces_left(
    # in
    corner_vertex_in: wp.array[wp.int32],
    root_in: wp.array[wp.int32],
    vertex_drop_in: wp.array[wp.int32],
    # out
    is_left_out: wp.array[wp.int32],
):
    """Faces whose corners stayed apart and that no pruned component (V,) took; it may be empty: none was pruned."""
    f = wp.tid()
    corner = corner_vertex_in[3 * f]
    a = root_in[corner]
    b = root_in[corner_vertex_in[3 * f + 1]]
    c = root_in[corner_vertex_in[3 * f + 2]]
    left = wp.int32(0)
    if a != b and b != c and c != a:
        left = 1
        if vertex_drop_in.shape[0] > 0 and vertex_drop_in[corner] >= 0:
            left = 0
    is_left_out[f] = left


@wp.kernel
def list_faces_left(
    # in
    before_in: wp.array[wp.int32],
    # out
    face_out: wp.array[wp.int32],
):
    """How many faces are left, then each of them, as far as there is room.

    ``before_in`` counts those up to each face, itself too.
    """
    f = wp.tid()
    before = wp.int32(0)
    if f > 0:
        before = before_in[f - 1]
    place = before_in[f]
    if place > before and place < face_out.shape[0]:
        face_out[place] = f
    if f == before_in.shape[0] - 1:
        face_out[0] = place
