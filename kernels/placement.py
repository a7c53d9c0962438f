"""Place every output vertex in every frame: exact quadric of its cluster, solved against its material anchor."""

import warp as wp

from warpqem.kernels.plane_quadrics import border_plane
from warpqem.kernels.quadric import Quadric, anchored_minimiser, plane_quadric
from warpqem.kernels.topology import half_edge_target, next_corner, previous_corner

wp.set_module_options({"enable_backward": False})  # no gradients are taken


@wp.struct
class Clusters:
    """What each of the C output vertices is made of, as compressed rows."""

    member_start: wp.array[wp.int32]  # (C+1,)
    member: wp.array[wp.int32]  # input vertices of the anchor
    member_weight: wp.array[wp.float32]  # sum 1 per cluster
    face_start: wp.array[wp.int32]  # (C+1,)
    face: wp.array[wp.vec3i]  # corners of the input faces with a corner in the cluster
    face_weight: wp.array[wp.float32]  # corners in the cluster, each times its vertex's quadric scale
    border_start: wp.array[wp.int32]  # (C+1,)
    border: wp.array[wp.int32]  # border and seam half-edges with an end in the cluster
    border_weight: wp.array[wp.float32]
    solved: wp.array[wp.int32]  # (C,) 0: the vertex is the anchor itself


@wp.kernel
def place_vertices(
    points_in: wp.array2d[wp.vec3],
    corner_vertex_in: wp.array[wp.int32],
    clusters: Clusters,
    epsilon: wp.float32,
    # outputs
    points_out: wp.array2d[wp.vec3],
    normal_out: wp.array2d[wp.vec3],
):
    """Positions (B, C) of a block of B frames (B, V), in diagonals, and the area-weighted normal of each cluster."""
    t, c = wp.tid()
    anchor = wp.vec3()
    for i in range(clusters.member_start[c], clusters.member_start[c + 1]):
        anchor += clusters.member_weight[i] * points_in[t, clusters.member[i]]
    q = Quadric()
    normal = wp.vec3()
    for i in range(clusters.face_start[c], clusters.face_start[c + 1]):
        f = clusters.face[i]
        p = points_in[t, f[0]]
        cross = wp.cross(points_in[t, f[1]] - p, points_in[t, f[2]] - p)
        length = wp.length(cross)
        normal += cross
        if length > 0.0:
            # Twice the area is the cross product's length: area n n^T = cross cross^T / (2 length).
            q += plane_quadric(cross, wp.dot(cross, anchor - p), 0.5 * clusters.face_weight[i] / length)
    normal_out[t, c] = normal
    x = anchor
    if clusters.solved[c] == 1:
        for i in range(clusters.border_start[c], clusters.border_start[c + 1]):
            h = clusters.border[i]
            plane = border_plane(
                points_in[t, corner_vertex_in[h]],
                points_in[t, half_edge_target(corner_vertex_in, h)],
                points_in[t, corner_vertex_in[previous_corner(h)]],
                anchor,
            )
            q += plane * clusters.border_weight[i]
        x = anchor + anchored_minimiser(q, epsilon)
    points_out[t, c] = x


@wp.kernel
def count_flips(
    points_in: wp.array2d[wp.vec3],
    normal_in: wp.array2d[wp.vec3],
    corner_vertex_in: wp.array[wp.int32],
    # outputs
    flip_count: wp.array[wp.int32],
):
    """Output faces per frame that face away from the input faces gathered in their three vertices."""
    t, f = wp.tid()
    a = corner_vertex_in[3 * f]
    b = corner_vertex_in[next_corner(3 * f)]
    c = corner_vertex_in[previous_corner(3 * f)]
    p = points_in[t, a]
    n = wp.cross(points_in[t, b] - p, points_in[t, c] - p)
    if wp.dot(n, normal_in[t, a] + normal_in[t, b] + normal_in[t, c]) < 0.0:
        wp.atomic_add(flip_count, t, 1)
