"""Compressed rows of clusters: their vertices, the nearest of these, and their faces, each once."""

import warp as wp

wp.set_module_options({"enable_backward": False})  # no gradients are taken


@wp.kernel
def choose_highest(
    # in
    cluster_in: wp.array[wp.int32],
    rank_in: wp.array[wp.int32],
    highest_rank_in: wp.array[wp.int32],
    # out
    cluster_out: wp.array[wp.int32],
):
    """The cluster of each vertex that has the highest rank in it; -1 of others, and where there is no cluster."""
    v = wp.tid()
    cluster = cluster_in[v]
    if cluster >= 0 and rank_in[v] < highest_rank_in[cluster]:
        cluster = wp.int32(-1)
    cluster_out[v] = cluster


@wp.kernel
def choose_nearest(
    # in
    start_in: wp.array[wp.int32],
    vertex_in: wp.array[wp.int32],
    distance_in: wp.array[wp.float32],
    chosen_start_in: wp.array[wp.int32],
    # out
    chosen_out: wp.array[wp.int32],
):
    """The nearest vertices of each cluster, as many as its row of ``chosen_out`` takes, the nearest first.

    Vertices as near as each other stay in their order (insertion sort; rows are short).
    """
    cluster = wp.tid()
    first = chosen_start_in[cluster]
    most = chosen_start_in[cluster + 1] - first
    count = wp.int32(0)
    for i in range(start_in[cluster], start_in[cluster + 1]):
        vertex = vertex_in[i]
        distance = distance_in[vertex]
        j = wp.int32(count)
        while j > 0 and distance_in[chosen_out[first + j - 1]] > distance:
            if j < most:
                chosen_out[first + j] = chosen_out[first + j - 1]
            j -= 1
        if j < most:
            chosen_out[first + j] = vertex
            count = wp.min(count + 1, most)


@wp.kernel
def key_members(
    # in
    cluster_in: wp.array[wp.int32],
    distance_in: wp.array[wp.float32],
    cluster_count: wp.int32,
    # out
    key_out: wp.array[wp.int64],
    vertex_out: wp.array[wp.int32],
):
    """Every vertex with a key to sort by: its cluster, then the bits of its distance, which ascend with it.

    A vertex without a cluster (-1) comes last.
    """
    v = wp.tid()
    cluster = wp.where(cluster_in[v] >= 0, cluster_in[v], cluster_count)
    key_out[v] = (wp.int64(cluster) << wp.int64(32)) | wp.int64(wp.cast(distance_in[v], wp.int32))
    vertex_out[v] = v


@wp.kernel
def take_nearest(
    # in
    key_in: wp.array[wp.int64],
    vertex_in: wp.array[wp.int32],
    start_in: wp.array[wp.int32],
    chosen_start_in: wp.array[wp.int32],
    # out
    chosen_out: wp.array[wp.int32],
):
    """What :func:`choose_nearest` finds, of sorted vertices: the first of each cluster, a thread for each vertex."""
    i = wp.tid()
    cluster = wp.int32(key_in[i] >> wp.int64(32))
    if cluster < chosen_start_in.shape[0] - 1:
        place = chosen_start_in[cluster] + i - start_in[cluster]
        if place < chosen_start_in[cluster + 1]:
            chosen_out[place] = vertex_in[i]


@wp.kernel
def label_corners(
    # in
    corner_vertex_in: wp.array[wp.int32],
    cluster_in: wp.array[wp.int32],
    weight_in: wp.array[wp.float32],
    # out
    cluster_out: wp.array[wp.int32],
    weight_out: wp.array[wp.float32],
):
    """Cluster and weight of each corner: those of its vertex."""
    h = wp.tid()
    v = corner_vertex_in[h]
    cluster_out[h] = cluster_in[v]
    weight_out[h] = weight_in[v]


@wp.kernel
def gather_corners(
    # in
    face_in: wp.array[wp.int32],
    corner_vertex_in: wp.array[wp.int32],
    total_in: wp.array[wp.int32],
    first: wp.int32,
    # out
    corners_out: wp.array[wp.vec3i],
):
    """The corners of each of some faces, ``total_in`` (1,) of them; the first one here is the ``first`` of all."""
    i = wp.tid()
    if first + i >= total_in[0]:
        return
    h = 3 * face_in[i]
    corners_out[i] = wp.vec3i(corner_vertex_in[h], corner_vertex_in[h + 1], corner_vertex_in[h + 2])


@wp.kernel
def count_faces(
    # in
    start_in: wp.array[wp.int32],
    corner_in: wp.array[wp.int32],
    # out
    face_count_out: wp.array[wp.int32],
):
    """Faces with a corner in each cluster, whose corners come in ascending order."""
    cluster = wp.tid()
    count = wp.int32(0)
    before = wp.int32(-1)
    for i in range(start_in[cluster], start_in[cluster + 1]):
        f = corner_in[i] // 3
        if f != before:
            count += 1
        before = f
    face_count_out[cluster] = count


@wp.kernel
def list_faces(
    # in
    start_in: wp.array[wp.int32],
    corner_in: wp.array[wp.int32],
    corner_weight_in: wp.array[wp.float32],
    face_start_in: wp.array[wp.int32],
    # out
    face_out: wp.array[wp.int32],
    weight_out: wp.array[wp.float32],
):
    """The faces of each cluster, ascending, weighted by the sum over their corners in it."""
    cluster = wp.tid()
    j = face_start_in[cluster] - 1
    before = wp.int32(-1)
    weight = wp.float64(0.0)
    for i in range(start_in[cluster], start_in[cluster + 1]):
        h = corner_in[i]
        f = h // 3
        if f != before:
            j += 1
            weight = wp.float64(0.0)
            face_out[j] = f
        before = f
        weight += wp.float64(corner_weight_in[h])
        weight_out[j] = wp.float32(weight)
