"""Closest point on a triangle mesh: bounding-volume search in single precision, result in double precision."""

from typing import Any

import warp as wp

# No gradients are taken, and leaving out the adjoint code halves the compile time.
wp.set_module_options({"enable_backward": False})

# Search radius in mesh units (the caller scales the mesh to unit diagonal): everything is nearer, and its square still
# fits single precision.
SEARCH_RADIUS = wp.constant(1.0e15)

# Single precision places a point of a unit-sized mesh to about 2e-7. Below this distance that is more than 2e-4 of the
# distance itself and may pick the wrong face of two neighbours, so the choice is made again in double precision.
EXACT_BELOW = wp.constant(wp.float64(1.0e-3))

# Added to the box of the second search: several times the rounding of the single-precision boxes of the hierarchy.
BOX_MARGIN = wp.constant(1.0e-6)

# The foot of a perpendicular is the nearest point for certain where its squared distance from every edge is more than
# this part of the squared lengths at work: eight times what single precision rounds squared distances by, of 6e-8.
INSIDE_MARGIN = wp.constant(wp.float32(2.0e-5))
# So flat a triangle (a squared sine) rounds the foot itself.
SLIVER = wp.constant(wp.float32(1.0e-4))


@wp.func
def double_point(p: wp.vec3) -> wp.vec3d:
    """A point in double precision."""
    return wp.vec3d(wp.float64(p[0]), wp.float64(p[1]), wp.float64(p[2]))


@wp.func
def single_point(p: wp.vec3d) -> wp.vec3:
    """A point in single precision."""
    return wp.vec3(wp.float32(p[0]), wp.float32(p[1]), wp.float32(p[2]))


@wp.func
def segment_parameter(p: Any, a: Any, b: Any):
    """Parameter in [0, 1] of the point of segment ab closest to p; 0 for a segment without length."""
    ab = b - a
    length_squared = wp.dot(ab, ab)
    zero = type(length_squared)(0.0)
    if length_squared == zero:
        return zero
    return wp.clamp(wp.dot(p - a, ab) / length_squared, zero, type(length_squared)(1.0))


@wp.func
def offset_squared(p: Any, a: Any, b: Any, c: Any, barycentric: Any):
    """Squared distance from p to the point of triangle abc with the given barycentric coordinates."""
    r = (p - a) - barycentric[1] * (b - a) - barycentric[2] * (c - a)
    return wp.dot(r, r)


@wp.func
def is_well_inside(ab: Any, ac: Any, ap: Any, normal_squared: Any, foot: Any) -> wp.bool:
    """Whether the foot of a perpendicular, by its barycentric coordinates, is so far inside that no edge is as near.

    That is, by more than single precision rounds distances; never so for a sliver.
    """
    ab_squared = wp.dot(ab, ab)
    ac_squared = wp.dot(ac, ac)
    bc = ac - ab
    rounding = type(normal_squared)(INSIDE_MARGIN) * (ab_squared + ac_squared + wp.dot(ap, ap))
    zero = type(normal_squared)(0.0)
    # Squared distances of the foot from the edges are these parts of the heights.
    return (
        foot[0] > zero
        and foot[1] > zero
        and foot[2] > zero
        and normal_squared > type(normal_squared)(SLIVER) * ab_squared * ac_squared
        and foot[2] * foot[2] * normal_squared > rounding * ab_squared
        and foot[1] * foot[1] * normal_squared > rounding * ac_squared
        and foot[0] * foot[0] * normal_squared > rounding * wp.dot(bc, bc)
    )


@wp.func
def closest_barycentric(p: Any, a: Any, b: Any, c: Any):
    """Barycentric coordinates of the point of triangle abc closest to p; right for degenerate triangles too.

    The best of the three edges is compared with the foot of the perpendicular, where that lies inside: no case
    distinction depends on the sign of a rounded determinant. Any precision.
    """
    zero = type(p[0])(0.0)
    one = type(p[0])(1.0)
    ab = b - a
    ac = c - a
    ap = p - a
    normal = wp.cross(ab, ac)
    normal_squared = wp.dot(normal, normal)
    foot = wp.vector(zero, zero, zero)
    if normal_squared > zero:
        v = wp.dot(wp.cross(ap, ac), normal) / normal_squared
        w = wp.dot(wp.cross(ab, ap), normal) / normal_squared
        foot = wp.vector(one - v - w, v, w)
        if is_well_inside(ab, ac, ap, normal_squared, foot):
            return foot

    t = segment_parameter(p, a, b)
    best = wp.vector(one - t, t, zero)
    best_squared = offset_squared(p, a, b, c, best)

    t = segment_parameter(p, b, c)
    candidate = wp.vector(zero, one - t, t)
    candidate_squared = offset_squared(p, a, b, c, candidate)
    if candidate_squared < best_squared:
        best = candidate
        best_squared = candidate_squared

    t = segment_parameter(p, c, a)
    candidate = wp.vector(t, zero, one - t)
    candidate_squared = offset_squared(p, a, b, c, candidate)
    if candidate_squared < best_squared:
        best = candidate
        best_squared = candidate_squared

    if normal_squared > zero:
        inside = foot[1] >= zero and foot[2] >= zero and foot[1] + foot[2] <= one
        if inside and offset_squared(p, a, b, c, foot) < best_squared:
            best = foot
    return best


@wp.struct
class Hit:
    """The point of a mesh nearest to another point."""

    face: wp.int32  # -1 for none
    barycentric: wp.vec3d
    squared: wp.float64  # the squared distance


@wp.func
def closest_on_face(points: wp.array[wp.vec3d], corner_vertex: wp.array[wp.int32], face: wp.int32, p: wp.vec3d) -> Hit:
    """The nearest point of one face."""
    a = points[corner_vertex[3 * face]]
    b = points[corner_vertex[3 * face + 1]]
    c = points[corner_vertex[3 * face + 2]]
    hit = Hit()
    hit.face = face
    hit.barycentric = closest_barycentric(p, a, b, c)
    hit.squared = offset_squared(p, a, b, c, hit.barycentric)
    return hit


@wp.func
def closest_on_mesh(mesh: wp.uint64, points: wp.array[wp.vec3d], indices: wp.array[wp.int32], p: wp.vec3d) -> Hit:
    """The nearest point of a mesh, none where the search finds no face: all of them are slivers."""
    hit = Hit()
    hit.face = wp.int32(-1)
    p_single = single_point(p)
    found = wp.mesh_query_point_no_sign(mesh, p_single, SEARCH_RADIUS)
    if found.result:
        hit = closest_on_face(points, indices, found.face, p)
        if hit.squared < EXACT_BELOW * EXACT_BELOW:
            radius = wp.float32(wp.sqrt(hit.squared)) + BOX_MARGIN
            extent = wp.vec3(radius, radius, radius)
            query = wp.mesh_query_aabb(mesh, p_single - extent, p_single + extent)
            face = wp.int32(0)
            while wp.mesh_query_next(query, face):
                other = closest_on_face(points, indices, face, p)
                if other.squared < hit.squared or (other.squared == hit.squared and face < hit.face):
                    hit = other
    return hit


@wp.kernel
def find_closest_points(
    # in
    mesh_in: wp.uint64,
    points_in: wp.array[wp.vec3d],
    indices_in: wp.array[wp.int32],
    queries_in: wp.array[wp.vec3d],
    # out
    distance_out: wp.array[wp.float64],
    face_out: wp.array[wp.int32],
    barycentric_out: wp.array[wp.vec3d],
):
    """Closest face, barycentric coordinates and distance per query; face -1 where the search finds no face."""
    i = wp.tid()
    hit = closest_on_mesh(mesh_in, points_in, indices_in, queries_in[i])
    face_out[i] = hit.face
    if hit.face >= 0:
        distance_out[i] = wp.sqrt(hit.squared)
        barycentric_out[i] = hit.barycentric
