"""The material anchor of an output vertex: constant weights over input vertices of its cluster, one set for all frames.

With the cluster's quadric ``(A, b, c)`` in key frame ``t`` about the ordering's position and ``p_i`` its input vertices
relative to it, ``sum_t Q_t(sum_i w_i p_i) = w^T G w`` for weights that sum to one, with
``G_ij = sum_t p_i^T A p_j + b.p_i + b.p_j + c``. Minimising ``w^T G w + r |w - 1/n|^2`` subject to ``sum w = 1`` gives
``w`` proportional to ``(G + r I)^-1 1``: one Cholesky solve per cluster, ``r = regularisation tr(G) / n``.
"""

from typing import Any

import warp as wp

from warpqem.kernels.lanes import (
    POINTS_ARRAY,
    QUADRIC_ARRAY,
    lane_dot,
    lane_inverse_length,
    lane_kernel,
    lane_max,
    lane_sum,
)
from warpqem.kernels.quadric import apply_matrix, linear_part, trace

# Entries of G are sums of products of the size of tr(A) |p|^2 that cancel where a cluster is flat; float32 leaves about
# 1e-7 of that size. Regularisation by 1e-5 of it keeps such a matrix positive definite: a flat cluster gets equal
# weights.
ROUNDING_REGULARISATION = wp.constant(wp.float32(1.0e-5))
# An anchor may lie so far beyond its members, in radii of the cluster: the middle of a spherical cap of half an
# angle of 30 degrees does.
OVERHANG = wp.constant(wp.float32(0.25))
# Added to the diagonal for clusters without any extent.
MIN_DIAGONAL = wp.constant(wp.float32(1.0e-20))


@lane_kernel(key_position_in=POINTS_ARRAY, ordered_position_in=POINTS_ARRAY, quadric_in=QUADRIC_ARRAY)
def fill_gram_matrices(
    # in
    cluster_vertex_in: wp.array[wp.int32],
    member_start_in: wp.array[wp.int32],
    member_in: wp.array[wp.int32],
    matrix_start_in: wp.array[wp.int32],
    key_position_in: Any,
    ordered_position_in: Any,
    quadric_in: Any,
    lanes: wp.int32,
    # in and out
    matrix: wp.array[wp.float32],
):
    """Add the quadric form of each pair of members to the packed Gram matrix of their cluster, over all key frames.

    Each of ``lanes`` threads of a cluster takes every so manieth row.
    """
    cluster, lane = wp.tid()
    u = cluster_vertex_in[cluster]
    first = member_start_in[cluster]
    for i in range(lane, member_start_in[cluster + 1] - first, lanes):
        o = matrix_start_in[cluster] + packed(i, 0)
        for t in range(key_position_in.shape[1]):
            q = quadric_in[u, t]
            b = linear_part(q)
            origin = ordered_position_in[u, t]
            p = key_position_in[member_in[first + i], t] - origin
            y = apply_matrix(q, p) + b
            s = lane_sum(lane_dot(b, p) + q[9])
            for j in range(i + 1):
                r = key_position_in[member_in[first + j], t] - origin
                matrix[o + j] = matrix[o + j] + lane_sum(lane_dot(y, r)) + s


@wp.func
def extent_of_members(
    key_position: Any,
    ordered_position: Any,
    quadric: Any,
    u: wp.int32,
    member: wp.array[wp.int32],
    first: wp.int32,
    n: wp.int32,
) -> wp.float32:
    """Area times squared distance of the members from where ordering put the cluster's vertex, over all key frames."""
    size = wp.float32(0.0)
    for t in range(key_position.shape[1]):
        area = trace(quadric[u, t])
        origin = ordered_position[u, t]
        for i in range(n):
            p = key_position[member[first + i], t] - origin
            size += wp.dot(area, lane_dot(p, p))
    return size


@wp.func
def solve_for_sum_one(
    matrix: wp.array[wp.float32], o: wp.int32, n: wp.int32, weight: wp.array[wp.float32], first: wp.int32
):
    """The solution for ones on the right, by the factor at ``o``, divided by its sum: the least with a sum of one."""
    for i in range(n):
        s = wp.float32(1.0)
        for k in range(i):
            s -= matrix[o + packed(i, k)] * weight[first + k]
        weight[first + i] = s / matrix[o + packed(i, i)]
    sum = wp.float32(0.0)
    for back in range(n):
        i = n - 1 - back
        s = weight[first + i]
        for k in range(i + 1, n):
            s -= matrix[o + packed(k, i)] * weight[first + k]
        s = s / matrix[o + packed(i, i)]
        weight[first + i] = s
        sum += s
    for i in range(n):
        weight[first + i] = weight[first + i] / sum


@lane_kernel(key_position_in=POINTS_ARRAY, ordered_position_in=POINTS_ARRAY)
def measure_cluster_distances(
    # in
    root_in: wp.array[wp.int32],
    key_position_in: Any,
    ordered_position_in: Any,
    # out
    distance_out: wp.array[wp.float32],
):
    """Sum over key frames of the squared distance of an input vertex from where ordering put its cluster's vertex."""
    v = wp.tid()
    u = root_in[v]
    total = wp.float32(0.0)
    if u >= 0:
        for t in range(key_position_in.shape[1]):
            d = key_position_in[v, t] - ordered_position_in[u, t]
            total += lane_sum(lane_dot(d, d))
    distance_out[v] = total


@lane_kernel(key_position_in=POINTS_ARRAY, position=POINTS_ARRAY)
def put_in_the_middle(
    # in
    row_in: wp.array[wp.int32],
    member_start_in: wp.array[wp.int32],
    member_in: wp.array[wp.int32],
    key_position_in: Any,
    # in and out
    position: Any,
):
    """Put the vertices of some rows (n,) in the middle of the input vertices of their clusters."""
    cluster, t = wp.tid()
    first = member_start_in[cluster]
    last = member_start_in[cluster + 1]
    total = key_position_in.dtype()
    for i in range(first, last):
        total += key_position_in[member_in[i], t]
    position[row_in[cluster], t] = total / wp.float32(last - first)


@wp.func
def packed(i: wp.int32, j: wp.int32) -> wp.int32:
    """Index of entry ``(i, j)``, ``j <= i``, in a lower triangle stored by rows."""
    return i * (i + 1) // 2 + j


@wp.func
def factorise(g: wp.array[wp.float32], o: wp.int32, n: wp.int32):
    """Cholesky factor of the packed symmetric matrix at offset ``o``, in place."""
    for i in range(n):
        for j in range(i + 1):
            s = g[o + packed(i, j)]
            for k in range(j):
                s -= g[o + packed(i, k)] * g[o + packed(j, k)]
            if i == j:
                g[o + packed(i, i)] = wp.sqrt(wp.max(s, MIN_DIAGONAL))
            else:
                g[o + packed(i, j)] = s / g[o + packed(j, j)]


@lane_kernel(key_position_in=POINTS_ARRAY, ordered_position_in=POINTS_ARRAY, quadric_in=QUADRIC_ARRAY)
def solve_for_weights(
    # in
    cluster_vertex_in: wp.array[wp.int32],
    member_start_in: wp.array[wp.int32],
    member_in: wp.array[wp.int32],
    matrix_start_in: wp.array[wp.int32],
    key_position_in: Any,
    ordered_position_in: Any,
    quadric_in: Any,
    regularisation_in: wp.array[wp.float32],
    # in and out
    matrix: wp.array[wp.float32],
    # out
    weight_out: wp.array[wp.float32],
):
    """Weights of the members of each cluster, of its Gram matrix, which becomes its Cholesky factor.

    The first thread of a cluster does it. The others leave at once: threads in step would wait for each other's
    matrices, which lie apart.
    """
    cluster, lane = wp.tid()
    if lane > 0:
        return
    u = cluster_vertex_in[cluster]
    first = member_start_in[cluster]
    n = member_start_in[cluster + 1] - first
    o = matrix_start_in[cluster]
    size = extent_of_members(key_position_in, ordered_position_in, quadric_in, u, member_in, first, n)
    total = wp.float32(0.0)
    for i in range(n):
        total += matrix[o + packed(i, i)]
    shift = regularisation_in[cluster] * wp.max(total, 0.0) + ROUNDING_REGULARISATION * size
    shift = shift / wp.float32(n) + MIN_DIAGONAL
    for i in range(n):
        matrix[o + packed(i, i)] = matrix[o + packed(i, i)] + shift
    factorise(matrix, o, n)
    solve_for_sum_one(matrix, o, n, weight_out, first)


@lane_kernel(key_position_in=POINTS_ARRAY)
def measure_reach(
    # in
    member_start_in: wp.array[wp.int32],
    member_in: wp.array[wp.int32],
    key_position_in: Any,
    weight_in: wp.array[wp.float32],
    # out
    reach_out: wp.array2d[wp.float32],
    moved_out: wp.array2d[wp.float32],
):
    """How far the members of each cluster let its anchor go in each key frame (C, F), and how far it goes (C, B).

    Squared, from the members' mean. Negative weights take an anchor outside its cluster, where a convex surface wants
    it: a little way beyond the members that lie furthest in that direction, and no further than any of them. Planes
    that hardly meet, as those of a ridge or of a thin part that bends, would take it away along them, as a spike.
    """
    cluster, t = wp.tid()
    first = member_start_in[cluster]
    n = member_start_in[cluster + 1] - first
    total = key_position_in.dtype()
    for i in range(n):
        total += key_position_in[member_in[first + i], t]
    mean = total / wp.float32(n)
    offset = key_position_in.dtype()
    for i in range(n):
        offset += weight_in[first + i] * (key_position_in[member_in[first + i], t] - mean)
    inverse = lane_inverse_length(offset)
    along = lane_max(lane_dot(offset, offset), 0.0)
    farthest = along - along
    extent = along - along
    for i in range(n):
        p = key_position_in[member_in[first + i], t] - mean
        farthest = wp.max(farthest, lane_dot(p, p))
        extent = wp.max(extent, wp.cw_mul(lane_dot(p, offset), inverse))
    width = len(extent)
    for k in range(width):
        radius = wp.sqrt(farthest[k])
        limit = wp.min(extent[k] + OVERHANG * radius, radius)
        reach_out[cluster, t * width + k] = limit * limit
    moved_out[cluster, t] = lane_sum(along)


@wp.kernel
def keep_within_reach(
    # in
    member_start_in: wp.array[wp.int32],
    reach_in: wp.array2d[wp.float32],
    moved_in: wp.array2d[wp.float32],
    # in and out
    weight: wp.array[wp.float32],
):
    """Mix the weights of each cluster with equal ones, so that its anchor goes hardly further than its members do.

    One share for all frames keeps it on the material.
    """
    cluster = wp.tid()
    first = member_start_in[cluster]
    n = member_start_in[cluster + 1] - first
    reach = wp.float32(0.0)
    for t in range(reach_in.shape[1]):
        reach += reach_in[cluster, t]
    moved = wp.float32(0.0)
    for t in range(moved_in.shape[1]):
        moved += moved_in[cluster, t]
    share = wp.float32(1.0)
    if not moved <= reach:
        share = wp.sqrt(reach / moved)
    finite = wp.isfinite(share)
    for i in range(n):
        weight[first + i] = share * weight[first + i] + (1.0 - share) / wp.float32(n)
        finite = finite and wp.isfinite(weight[first + i])
    # Of points nearly in one place the matrix is what rounding left of the quadric's constant, which may be negative:
    # its inverse overflows. Any weights give the same place.
    if not finite:
        for i in range(n):
            weight[first + i] = 1.0 / wp.float32(n)


@wp.kernel
def finish_anchors(
    # in
    start_in: wp.array[wp.int32],
    kept_in: wp.array[wp.int32],
    pinned_in: wp.array[wp.int32],
    # in and out
    vertex: wp.array[wp.int32],
    weight: wp.array[wp.float32],
    # out
    heaviest_out: wp.array[wp.int32],
):
    """Anchor each pinned cluster to its own vertex alone; then find the member of each with the largest weight.

    The vertex takes the place of the nearest member, as it may not be among them. Of members that weigh the same the
    first counts.
    """
    cluster = wp.tid()
    first = start_in[cluster]
    last = start_in[cluster + 1]
    if pinned_in[cluster] != 0:
        vertex[first] = kept_in[cluster]
        weight[first] = 1.0
        for j in range(first + 1, last):
            weight[j] = 0.0
    heaviest = first
    for j in range(first + 1, last):
        if weight[j] > weight[heaviest]:
            heaviest = j
    heaviest_out[cluster] = vertex[heaviest]
