"""Faces in lists by vertex or cluster: keys for a sort, and where the lists begin in what it gives."""

import warp as wp

from warpqem.kernels.topology import count_below

wp.set_module_options({"enable_backward": False})  # no gradients are taken


@wp.kernel
def key_faces_of_corners(
    # in
    corner_vertex_in: wp.array[wp.int32],
    cluster_in: wp.array[wp.int32],
    list_count: wp.int32,
    # out
    key_out: wp.array[wp.int32],
    face_out: wp.array[wp.int32],
):
    """The face of every corner (3N,), with its vertex, or the cluster of that where there are any, as the key.

    Those of no cluster come last, with the number of lists.
    """
    h = wp.tid()
    v = corner_vertex_in[h]
    if cluster_in.shape[0] > 0:
        v = cluster_in[v]
    key_out[h] = wp.where(v >= 0, v, list_count)
    face_out[h] = h // 3


@wp.kernel
def start_lists(
    # in
    key_in: wp.array[wp.int32],
    corner_count: wp.int32,
    # out
    start_out: wp.array[wp.int32],
):
    """Where each list (C+1,) begins among ``corner_count`` sorted keys: a binary search each."""
    c = wp.tid()
    start_out[c] = count_below(key_in, corner_count, c)
