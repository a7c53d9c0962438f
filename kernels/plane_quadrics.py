"""Initial quadrics: area-weighted face planes and constraint planes along borders and seams, per vertex and frame."""

import warp as wp

from warpqem.kernels.quadric import Quadric, plane_quadric
from warpqem.kernels.topology import half_edge_target

wp.set_module_options({"enable_backward": False})  # no gradients are taken


@wp.func
def border_plane(p: wp.vec3, q: wp.vec3, r: wp.vec3, origin: wp.vec3) -> Quadric:
    """The plane through edge ``p q``, perpendicular to its face ``p q r``, weighted by the edge's squared length."""
    edge = q - p
    m = wp.cross(edge, wp.cross(edge, r - p))
    length = wp.length(m)
    if length <= 0.0:
        return Quadric()
    n = m / length
    return plane_quadric(n, wp.dot(n, origin - p), wp.dot(edge, edge))


@wp.kernel
def weigh_face_normals(
    corner_vertex_in: wp.array[wp.int32],
    position_in: wp.array2d[wp.vec3],
    # outputs
    weighted_normal_out: wp.array2d[wp.vec3],
):
    """``n sqrt(area)`` per face and frame: its outer product with itself is the face's quadric matrix."""
    f, t = wp.tid()
    p = position_in[corner_vertex_in[3 * f], t]
    cross = wp.cross(position_in[corner_vertex_in[3 * f + 1], t] - p, position_in[corner_vertex_in[3 * f + 2], t] - p)
    length = wp.length(cross)
    normal = wp.vec3()
    if length > 0.0:
        normal = cross * (1.0 / wp.sqrt(2.0 * length))
    weighted_normal_out[f, t] = normal


@wp.kernel
def gather_vertex_quadrics(
    star_start_in: wp.array[wp.int32],
    star_corner_in: wp.array[wp.int32],
    weighted_normal_in: wp.array2d[wp.vec3],
    quadric_scale_in: wp.array[wp.float32],
    # outputs
    quadric_out: wp.array2d[Quadric],
):
    """Sum of the face quadrics of a vertex's star. The origin is the vertex, which lies on every plane: b = c = 0."""
    v, t = wp.tid()
    diagonal = wp.vec3()
    mixed = wp.vec3()
    for i in range(star_start_in[v], star_start_in[v + 1]):
        n = weighted_normal_in[star_corner_in[i] // 3, t]
        diagonal += wp.cw_mul(n, n)
        mixed += wp.vec3(n[0] * n[1], n[0] * n[2], n[1] * n[2])
    diagonal *= quadric_scale_in[v]
    mixed *= quadric_scale_in[v]
    quadric_out[v, t] = Quadric(diagonal[0], mixed[0], mixed[1], diagonal[1], mixed[2], diagonal[2], 0.0, 0.0, 0.0, 0.0)


@wp.kernel
def add_border_planes(
    border_corner_in: wp.array[wp.int32],
    border_start_in: wp.array[wp.int32],
    border_vertex_in: wp.array[wp.int32],
    corner_vertex_in: wp.array[wp.int32],
    position_in: wp.array2d[wp.vec3],
    quadric_scale_in: wp.array[wp.float32],
    border_weight: wp.float32,
    # outputs
    quadric: wp.array2d[Quadric],
):
    """Add the planes of the border and seam edges of each vertex that has any (a list each: no atomics are needed)."""
    i, t = wp.tid()
    v = border_vertex_in[i]
    origin = position_in[v, t]
    total = Quadric()
    for j in range(border_start_in[i], border_start_in[i + 1]):
        h = border_corner_in[j]
        f = h // 3
        p = position_in[corner_vertex_in[h], t]
        q = position_in[half_edge_target(corner_vertex_in, h), t]
        r = position_in[corner_vertex_in[3 * f + (h + 2) % 3], t]
        total += border_plane(p, q, r, origin)
    quadric[v, t] = quadric[v, t] + total * (border_weight * quadric_scale_in[v])
