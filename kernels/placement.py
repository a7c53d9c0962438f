"""Place every output vertex in every frame: exact quadric of its cluster, solved against its material anchor."""

from typing import Any

import warp as wp

from warpqem.kernels.lanes import POINTS_ARRAY, lane_cross, lane_dot, lane_inverse_length, lane_kernel
from warpqem.kernels.plane_quadrics import add_border_plane
from warpqem.kernels.quadric import add_plane, tangential_minimiser, zero_quadric
from warpqem.kernels.topology import half_edge_target, next_corner, previous_corner


@wp.struct
class Clusters:
    """What each of the C output vertices is made of, as compressed rows."""

    member_start: wp.array[wp.int32]  # (C+1,)
    member: wp.array[wp.int32]  # input vertices of the anchor
    member_weight: wp.array[wp.float32]  # sum 1 per cluster
    face_start: wp.array[wp.int32]  # (C+1,)
    face: wp.array[wp.vec3i]  # corners of the input faces with a corner in the cluster
    face_weight: wp.array[wp.float32]  # corners in the cluster, each times its vertex's quadric scale
    other_start: wp.array[wp.int32]  # (C+1,)
    other: wp.array[wp.vec3i]  # corners of the input faces at vertices whose quadrics count in the cluster too
    other_weight: wp.array[wp.float32]
    border_start: wp.array[wp.int32]  # (C+1,)
    border: wp.array[wp.int32]  # border and seam half-edges with an end in the cluster
    border_weight: wp.array[wp.float32]
    solved: wp.array[wp.int32]  # (C,) 0: the vertex is the anchor itself
    stiffness: wp.array[wp.float32]  # (C,) regularisation towards the anchor, relative to the quadric


@lane_kernel(points_in=POINTS_ARRAY, points_out=POINTS_ARRAY, normal_out=POINTS_ARRAY)
def place_vertices(
    # in
    points_in: Any,
    corner_vertex_in: wp.array[wp.int32],
    clusters: Clusters,
    first_cluster: wp.int32,
    # out
    points_out: Any,
    normal_out: Any,
):
    """Positions (C, B) of blocks of frames (V, B), in diagonals, and the area-weighted normal of each cluster."""
    i, t = wp.tid()
    c = first_cluster + i
    anchor = points_out.dtype()
    for j in range(clusters.member_start[c], clusters.member_start[c + 1]):
        anchor += clusters.member_weight[j] * points_in[clusters.member[j], t]
    q = zero_quadric(anchor)
    normal = points_out.dtype()
    for j in range(clusters.face_start[c], clusters.face_start[c + 1]):
        f = clusters.face[j]
        p = points_in[f[0], t]
        cross = lane_cross(points_in[f[1], t] - p, points_in[f[2], t] - p)
        normal += cross
        # Twice the area is the cross product's length: area n n^T = cross cross^T / (2 length).
        weight = lane_inverse_length(cross) * (0.5 * clusters.face_weight[j])
        q = add_plane(q, cross, lane_dot(cross, anchor - p), weight)
    normal_out[c, t] = normal
    x = anchor
    if clusters.solved[c] == 1:
        # Planes of other vertices: they are no part of the surface here, and have no share in its normal.
        for j in range(clusters.other_start[c], clusters.other_start[c + 1]):
            f = clusters.other[j]
            p = points_in[f[0], t]
            cross = lane_cross(points_in[f[1], t] - p, points_in[f[2], t] - p)
            weight = lane_inverse_length(cross) * (0.5 * clusters.other_weight[j])
            q = add_plane(q, cross, lane_dot(cross, anchor - p), weight)
        for j in range(clusters.border_start[c], clusters.border_start[c + 1]):
            h = clusters.border[j]
            a = points_in[corner_vertex_in[h], t]
            b = points_in[half_edge_target(corner_vertex_in, h), t]
            opposite = points_in[corner_vertex_in[previous_corner(h)], t]
            q = add_border_plane(q, a, b, opposite, anchor, clusters.border_weight[j])
        x = anchor + tangential_minimiser(q, clusters.stiffness[c])
    points_out[c, t] = x


@lane_kernel(points_in=POINTS_ARRAY, normal_in=POINTS_ARRAY)
def count_flips(
    # in
    points_in: Any,
    normal_in: Any,
    corner_vertex_in: wp.array[wp.int32],
    # out
    flip_count: wp.array[wp.int32],
):
    """Output faces per frame that face away from the input faces gathered in their three vertices."""
    f, t = wp.tid()
    a = corner_vertex_in[3 * f]
    b = corner_vertex_in[next_corner(3 * f)]
    c = corner_vertex_in[previous_corner(3 * f)]
    p = points_in[a, t]
    n = lane_cross(points_in[b, t] - p, points_in[c, t] - p)
    agreement = lane_dot(n, normal_in[a, t] + normal_in[b, t] + normal_in[c, t])
    if wp.min(agreement) < 0.0:
        width = len(agreement)
        for k in range(width):
            if agreement[k] < 0.0:
                wp.atomic_add(flip_count, t * width + k, 1)
