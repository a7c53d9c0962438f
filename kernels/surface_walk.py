"""Closest points of a surface that was near a moment ago: a walk over its vertices, then a bounded search."""

import warp as wp

from warpqem.kernels.topology import half_edge_target

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# Steps from star to star that a walk takes at most. Within a cluster two or three do, and it only gives a bound.
MOST_STEPS = wp.constant(32)

# The search goes a little further than the bound, so that rounding does not put the vertex that gave it out of reach.
BOUND_MARGIN = wp.constant(wp.float32(1.001))
LEAST_BOUND = wp.constant(wp.float32(1.0e-6))


@wp.struct
class Surface:
    """A mesh on several frames: positions (K, V), faces and stars."""

    points: wp.array2d[wp.vec3]
    corner_vertex: wp.array[wp.int32]
    star_start: wp.array[wp.int32]
    star_corner: wp.array[wp.int32]


@wp.struct
class Hit:
    """A point of a surface: face and barycentric weights, and a vertex near to it."""

    face: wp.int32
    barycentric: wp.vec3
    vertex: wp.int32


@wp.func
def surface_point(s: Surface, t: wp.int32, face: wp.int32, barycentric: wp.vec3) -> wp.vec3:
    """The point of a face in frame ``t``."""
    return (
        barycentric[0] * s.points[t, s.corner_vertex[3 * face]]
        + barycentric[1] * s.points[t, s.corner_vertex[3 * face + 1]]
        + barycentric[2] * s.points[t, s.corner_vertex[3 * face + 2]]
    )


@wp.func
def face_cross(s: Surface, t: wp.int32, face: wp.int32) -> wp.vec3:
    """Normal of a face in frame ``t``, twice the area long."""
    p = s.points[t, s.corner_vertex[3 * face]]
    return wp.cross(
        s.points[t, s.corner_vertex[3 * face + 1]] - p,
        s.points[t, s.corner_vertex[3 * face + 2]] - p,
    )


@wp.func
def walk_to_vertex(s: Surface, t: wp.int32, start: wp.int32, query: wp.vec3) -> wp.int32:
    """A vertex no further from the query than its neighbours, downhill from ``start``."""
    vertex = start
    best = wp.length_sq(s.points[t, start] - query)
    for _ in range(MOST_STEPS):
        here = vertex
        for i in range(s.star_start[here], s.star_start[here + 1]):
            v = half_edge_target(s.corner_vertex, s.star_corner[i])
            distance = wp.length_sq(s.points[t, v] - query)
            if distance < best:
                best = distance
                vertex = v
        if vertex == here:
            break
    return vertex


@wp.func
def closest_hit(s: Surface, mesh: wp.uint64, t: wp.int32, start: wp.int32, query: wp.vec3) -> Hit:
    """The nearest point of the surface in frame ``t``, whose hierarchy is ``mesh``; face -1 where there is none.

    A walk from a vertex that lies near bounds the distance, so that the hierarchy opens few boxes.
    """
    hit = Hit()
    hit.vertex = walk_to_vertex(s, t, start, query)
    bound = wp.length(s.points[t, hit.vertex] - query)
    found = wp.mesh_query_point_no_sign(mesh, query, BOUND_MARGIN * bound + LEAST_BOUND)
    hit.face = wp.int32(-1)
    if found.result:
        hit.face = found.face
        hit.barycentric = wp.vec3(found.u, found.v, 1.0 - found.u - found.v)
    return hit
