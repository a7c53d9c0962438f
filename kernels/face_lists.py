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
def mark_corners_in_clusters(
    # in
    corner_cluster_in: wp.array[wp.int32],
    # out
    is_inside_out: wp.array[wp.int32],
):
    """1 for each corner that has a cluster, 0 for others."""
    h = wp.tid()
    is_inside_out[h] = wp.where(corner_cluster_in[h] >= 0, wp.int32(1), wp.int32(0))


@wp.kernel
def key_corners_in_clusters(
    # in
    corner_cluster_in: wp.array[wp.int32],
    before_in: wp.array[wp.int32],
    room: wp.int32,
    # out
    key_out: wp.array[wp.int32],
    corner_out: wp.array[wp.int32],
):
    """The corners that have a cluster, with it as the key, as far as there is room.

    ``before_in`` counts those up to each corner, itself too.
    """
    h = wp.tid()
    cluster = corner_cluster_in[h]
    place = before_in[h] - 1
    if cluster >= 0 and place < room:
        key_out[place] = cluster
        corner_out[place] = h


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
