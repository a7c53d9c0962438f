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


@wp.func
def add_gram(
    key_position: Any,
    ordered_position: Any,
    quadric: Any,
    u: wp.int32,
    member: wp.array[wp.int32],
    first: wp.int32,
    n: wp.int32,
    matrix: wp.array[wp.float32],
    o: wp.int32,
) -> wp.float32:
    """Add the quadric form of each pair of members to the packed matrix at ``o``; returns area times squared distance.

    The quadrics are those of the cluster of ``u`` in all key frames.
    """
    size = wp.float32(0.0)
    for t in range(key_position.shape[1]):
        q = quadric[u, t]
        area = trace(q)
        b = linear_part(q)
        origin = ordered_position[u, t]
        for i in range(n):
            p = key_position[member[first + i], t] - origin
            y = apply_matrix(q, p) + b
            s = lane_sum(lane_dot(b, p) + q[9])
            size += wp.dot(area, lane_dot(p, p))
            for j in range(i + 1):
                r = key_position[member[first + j], t] - origin
                matrix[o + packed(i, j)] = matrix[o + packed(i, j)] + lane_sum(lane_dot(y, r)) + s
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


@wp.func
def share_within_reach(
    member: wp.array[wp.int32],
    key_position: Any,
    weight: wp.array[wp.float32],
    first: wp.int32,
    n: wp.int32,
) -> wp.float32:
    """The part of the way from the members' mean to their weighted sum that goes hardly further than the members do.

    Negative weights take an anchor outside its cluster, where a convex surface wants it: a little way beyond the
    members that lie furthest in that direction, and no further than any of them. Planes that hardly meet, as those of a
    ridge or of a thin part that bends, would take it away along them, as a spike. One factor for all frames keeps it on
    the material.
    """
    reach = wp.float32(0.0)
    moved = wp.float32(0.0)
    for t in range(key_position.shape[1]):
        total = key_position.dtype()
        for i in range(n):
            total += key_position[member[first + i], t]
        mean = total / wp.float32(n)
        offset = key_position.dtype()
        for i in range(n):
            offset += weight[first + i] * (key_position[member[first + i], t] - mean)
        inverse = lane_inverse_length(offset)
        along = lane_max(lane_dot(offset, offset), 0.0)
        farthest = along - along
        extent = along - along
        for i in range(n):
            p = key_position[member[first + i], t] - mean
            farthest = wp.max(farthest, lane_dot(p, p))
            extent = wp.max(extent, wp.cw_mul(lane_dot(p, offset), inverse))
        for k in range(len(extent)):
            radius = wp.sqrt(farthest[k])
            limit = wp.min(extent[k] + OVERHANG * radius, radius)
            reach += limit * limit
        moved += lane_sum(along)
    if moved <= reach:
        return 1.0
    return wp.sqrt(reach / moved)


@lane_kernel(key_position_in=POINTS_ARRAY, ordered_position_in=POINTS_ARRAY, quadric_in=QUADRIC_ARRAY)
def fit_anchor_weights(
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
    """Weights of the members of each cluster (``matrix`` is zeroed scratch for the packed Gram matrices)."""
    cluster = wp.tid()
    u = cluster_vertex_in[cluster]
    first = member_start_in[cluster]
    n = member_start_in[cluster + 1] - first
    o = matrix_start_in[cluster]
    size = add_gram(key_position_in, ordered_position_in, quadric_in, u, member_in, first, n, matrix, o)
    total = wp.float32(0.0)
    for i in range(n):
        total += matrix[o + packed(i, i)]
    shift = regularisation_in[cluster] * wp.max(total, 0.0) + ROUNDING_REGULARISATION * size
    shift = shift / wp.float32(n) + MIN_DIAGONAL
    for i in range(n):
        matrix[o + packed(i, i)] = matrix[o + packed(i, i)] + shift
    factorise(matrix, o, n)
    solve_for_sum_one(matrix, o, n, weight_out, first)
    share = share_within_reach(member_in, key_position_in, weight_out, first, n)
    finite = wp.isfinite(share)
    for i in range(n):
        weight_out[first + i] = share * weight_out[first + i] + (1.0 - share) / wp.float32(n)
        finite = finite and wp.isfinite(weight_out[first + i])
    # Of points nearly in one place the matrix is what rounding left of the quadric's constant, which may be negative:
    # its inverse overflows. Any weights give the same place.
    if not finite:
        for i in range(n):
            weight_out[first + i] = 1.0 / wp.float32(n)
