"""Closest point of a surface by walking over it: from vertex star to vertex star, as long as that leads nearer.

The walk starts at a vertex known to lie near (the two surfaces are versions of one), so it takes two or three stars,
needs no search structure per frame, and cannot end on another sheet that happens to pass close by.
"""

import warp as wp

from warpqem.kernels.closest_point import closest_barycentric, offset_squared
from warpqem.kernels.topology import half_edge_target

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# Steps from star to star that a walk takes at most. Within a cluster two or three do; a walk this long got lost.
MOST_STEPS = wp.constant(32)


@wp.struct
class Surface:
    """A mesh on several frames: positions (K, V), faces and stars."""

    points: wp.array2d[wp.vec3]
    corner_vertex: wp.array[wp.int32]
    star_start: wp.array[wp.int32]
    star_corner: wp.array[wp.int32]


@wp.struct
class Hit:
    """A point of a surface: face, barycentric weights, and the corner vertex it is nearest to."""

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
def walk_to_closest(s: Surface, t: wp.int32, start: wp.int32, query: wp.vec3) -> Hit:
    """The point nearest to the query in the last star of the walk from vertex ``start``; face -1 without any face.

    Vertices are cheaper to compare than faces, so the walk goes over vertices first.
    """
    hit = Hit()
    hit.face = wp.int32(-1)
    vertex = walk_to_vertex(s, t, start, query)
    hit.vertex = vertex
    best = wp.float32(wp.inf)
    for _ in range(MOST_STEPS):
        for i in range(s.star_start[vertex], s.star_start[vertex + 1]):
            face = s.star_corner[i] / 3
            a = s.points[t, s.corner_vertex[3 * face]]
            b = s.points[t, s.corner_vertex[3 * face + 1]]
            c = s.points[t, s.corner_vertex[3 * face + 2]]
            barycentric = closest_barycentric(query, a, b, c)
            distance = offset_squared(query, a, b, c, barycentric)
            if distance < best:
                best = distance
                hit.face = face
                hit.barycentric = barycentric
        if hit.face < 0:
            break
        corner = wp.int32(0)
        if hit.barycentric[1] > hit.barycentric[0]:
            corner = 1
        if hit.barycentric[2] > hit.barycentric[corner]:
            corner = 2
        hit.vertex = s.corner_vertex[3 * hit.face + corner]
        if hit.vertex == vertex:
            break
        vertex = hit.vertex
    return hit
