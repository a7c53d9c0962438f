"""Initial quadrics: area-weighted face planes and constraint planes along borders and seams, per vertex and frame."""

from typing import Any

import warp as wp

from warpqem.kernels.lanes import (
    POINTS_ARRAY,
    QUADRIC_ARRAY,
    lane_cross,
    lane_dot,
    lane_inverse_length,
    lane_kernel,
    lane_scale,
)
from warpqem.kernels.quadric import add_plane
from warpqem.kernels.topology import half_edge_target


@wp.func
def root_area_normal(p: Any, q: Any, r: Any):
    """``n sqrt(area)`` of a face: its outer product with itself is the face's quadric matrix."""
    cross = lane_cross(q - p, r - p)
    # The cross product's length is twice the area: n sqrt(area) = cross / sqrt(2 length).
    scale = lane_inverse_length(cross) * 0.5
    for k in range(len(scale)):
        scale[k] = wp.sqrt(scale[k])
    return lane_scale(scale, cross)


@wp.func
def add_border_plane(q: Any, a: Any, b: Any, c: Any, origin: Any, weight: wp.float32):
    """Add the plane through edge ``a b``, perpendicular to face ``a b c``, weighted by the edge's squared length."""
    edge = b - a
    m = lane_cross(edge, lane_cross(edge, c - a))
    n = lane_scale(lane_inverse_length(m), m)
    return add_plane(q, n, lane_dot(n, origin - a), lane_dot(edge, edge) * weight)


@lane_kernel(position_in=POINTS_ARRAY, weighted_normal_out=POINTS_ARRAY)
def weigh_face_normals(
    # in
    corner_vertex_in: wp.array[wp.int32],
    position_in: Any,
    # out
    weighted_normal_out: Any,
):
    """``n sqrt(area)`` per face and block of frames."""
    f, t = wp.tid()
    weighted_normal_out[f, t] = root_area_normal(
        position_in[corner_vertex_in[3 * f], t],
        position_in[corner_vertex_in[3 * f + 1], t],
        position_in[corner_vertex_in[3 * f + 2], t],
    )


@lane_kernel(weighted_normal_in=POINTS_ARRAY, quadric_out=QUADRIC_ARRAY)
def gather_vertex_quadrics(
    # in
    adjacency_start_in: wp.array[wp.int32],
    adjacent_corner_in: wp.array[wp.int32],
    weighted_normal_in: Any,
    quadric_scale_in: wp.array[wp.float32],
    # out
    quadric_out: Any,
):
    """Sum of the face quadrics around a vertex. The origin is the vertex, which lies on every plane: b = c = 0."""
    v, t = wp.tid()
    q = quadric_out.dtype()
    for i in range(adjacency_start_in[v], adjacency_start_in[v + 1]):
        n = weighted_normal_in[adjacent_corner_in[i] // 3, t]
        q[0] += wp.cw_mul(n[0], n[0])
        q[1] += wp.cw_mul(n[0], n[1])
        q[2] += wp.cw_mul(n[0], n[2])
        q[3] += wp.cw_mul(n[1], n[1])
        q[4] += wp.cw_mul(n[1], n[2])
        q[5] += wp.cw_mul(n[2], n[2])
    quadric_out[v, t] = q * quadric_scale_in[v]


@lane_kernel(position_in=POINTS_ARRAY, quadric=QUADRIC_ARRAY)
def add_border_planes(
    # in
    border_corner_in: wp.array[wp.int32],
    border_start_in: wp.array[wp.int32],
    border_vertex_in: wp.array[wp.int32],
    corner_vertex_in: wp.array[wp.int32],
    position_in: Any,
    quadric_scale_in: wp.array[wp.float32],
    border_weight: wp.float32,
    # in and out
    quadric: Any,
):
    """Add the planes of the border and seam edges of each vertex that has any (a list each: no atomics are needed)."""
    i, t = wp.tid()
    v = border_vertex_in[i]
    origin = position_in[v, t]
    q = quadric[v, t]
    weight = border_weight * quadric_scale_in[v]
    for j in range(border_start_in[i], border_start_in[i + 1]):
        h = border_corner_in[j]
        a = position_in[corner_vertex_in[h], t]
        b = position_in[half_edge_target(corner_vertex_in, h), t]
        c = position_in[corner_vertex_in[3 * (h // 3) + (h + 2) % 3], t]
        q = add_border_plane(q, a, b, c, origin, weight)
    quadric[v, t] = q
