"""Closest points of a surface that was near a moment ago: walks over its vertices, faces, borders and seams.

A walk goes downhill in distance and ends where no neighbour is nearer. From a start on the right part of the surface it
stays there, where a search over the whole mesh may land on the other side of a thin part; it takes a fraction of the
search's time. At a fold it may get stuck; then only the search helps.
"""

import warp as wp

from warpqem.kernels.closest_point import closest_barycentric, offset_squared, segment_parameter
from warpqem.kernels.topology import half_edge_target, next_corner

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# Steps that a walk takes at most. From a start within the same cluster two or three do.
MAX_STEPS = wp.constant(32)


@wp.struct
class Surface:
    """A mesh on K frames: positions, faces, vertex-corner adjacency and what lies across each edge."""

    points: wp.array2d[wp.vec3]  # (K, V)
    corner_vertex: wp.array[wp.int32]  # (3N,)
    adjacency_start: wp.array[wp.int32]  # (V+1,)
    adjacent_corner: wp.array[wp.int32]  # (3N,)
    opposite: wp.array[wp.int32]  # (3N,) the half-edge of the other direction, -1 at a border
    border_out: wp.array[wp.int32]  # (V,) the border half-edge that leaves a vertex, -1 where there is none
    border_in: wp.array[wp.int32]  # (V,) the one that arrives
    seam: wp.array[wp.int32]  # (3N,) 1 at both half-edges of a seam; empty where nobody asks for seams


@wp.struct
class Hit:
    """A point of a surface: face and barycentric weights."""

    face: wp.int32
    barycentric: wp.vec3
    squared: wp.float32  # squared distance from the query


@wp.struct
class LineHit:
    """A point of a border or seam: half-edge, part of the way along it, and squared distance from the query."""

    half_edge: wp.int32  # -1: none
    along: wp.float32
    squared: wp.float32


@wp.kernel
def link_half_edges(
    # in
    s: Surface,
    # out
    opposite_out: wp.array[wp.int32],
    border_out: wp.array[wp.int32],
    border_in: wp.array[wp.int32],
):
    """What lies across each edge of a face; the border arrays are -1 before.

    Of several borders at a vertex the last counts.
    """
    face = wp.tid()
    for k in range(3):
        h = 3 * face + k
        u = s.corner_vertex[h]
        v = s.corner_vertex[3 * face + (k + 1) % 3]
        opposite = wp.int32(-1)
        # Of several the last counts, so that the search goes back from there.
        first = s.adjacency_start[v]
        i = s.adjacency_start[v + 1] - 1
        while i >= first and opposite < 0:
            other = s.adjacent_corner[i]
            if half_edge_target(s.corner_vertex, other) == u:
                opposite = other
            i -= 1
        opposite_out[h] = opposite
        if opposite < 0:
            wp.atomic_max(border_out, u, h)
            wp.atomic_max(border_in, v, h)


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
    for _ in range(MAX_STEPS):
        here = vertex
        for i in range(s.adjacency_start[here], s.adjacency_start[here + 1]):
            v = half_edge_target(s.corner_vertex, s.adjacent_corner[i])
            distance = wp.length_sq(s.points[t, v] - query)
            if distance < best:
                best = distance
                vertex = v
        if vertex == here:
            break
    return vertex


@wp.func
def hit_face(s: Surface, t: wp.int32, face: wp.int32, query: wp.vec3) -> Hit:
    """The nearest point of one face in frame ``t``."""
    a = s.points[t, s.corner_vertex[3 * face]]
    b = s.points[t, s.corner_vertex[3 * face + 1]]
    c = s.points[t, s.corner_vertex[3 * face + 2]]
    hit = Hit()
    hit.face = face
    hit.barycentric = closest_barycentric(query, a, b, c)
    hit.squared = offset_squared(query, a, b, c, hit.barycentric)
    return hit


@wp.func
def hit_ring(s: Surface, t: wp.int32, vertex: wp.int32, query: wp.vec3, best: Hit) -> Hit:
    """``best``, or a nearer point on the faces around a vertex."""
    hit = best
    for i in range(s.adjacency_start[vertex], s.adjacency_start[vertex + 1]):
        face = s.adjacent_corner[i] / 3
        if face != hit.face:
            other = hit_face(s, t, face, query)
            if hit.face < 0 or other.squared < hit.squared:
                hit = other
    return hit


@wp.func
def step_across(s: Surface, t: wp.int32, query: wp.vec3, here: Hit) -> Hit:
    """A nearer point in the faces next to ``here``: across the edge that it lies on, or about its vertex."""
    hit = here
    inside = wp.int32(0)
    corner = wp.int32(0)
    for k in range(3):
        if here.barycentric[k] > 0.0:
            inside += 1
            corner = 3 * here.face + k
    if inside == 1:
        return hit_ring(s, t, s.corner_vertex[corner], query, here)
    if inside == 2:
        for k in range(3):
            if here.barycentric[k] <= 0.0:
                across = s.opposite[next_corner(3 * here.face + k)]
                if across >= 0:
                    other = hit_face(s, t, across / 3, query)
                    if other.squared < hit.squared:
                        hit = other
    return hit


@wp.func
def closest_hit(s: Surface, t: wp.int32, starts: wp.vec3i, face: wp.int32, query: wp.vec3) -> Hit:
    """The nearest point of the surface in frame ``t`` downhill from a face, or from up to three vertices.

    The vertices count where ``face`` is -1; those of -1 do not. Face -1 where there is none to start from. Three starts
    for the middle of a large face, from which no vertex is near.
    """
    hit = Hit()
    if face >= 0:
        hit = hit_face(s, t, face, query)
    else:
        hit.face = wp.int32(-1)
        for k in range(3):
            start = starts[k]
            if start >= 0 and (k == 0 or start != starts[0]) and (k < 2 or start != starts[1]):
                hit = hit_ring(s, t, walk_to_vertex(s, t, start, query), query, hit)
        if hit.face < 0:
            return hit
    for _ in range(MAX_STEPS):
        here = hit.face
        hit = step_across(s, t, query, hit)
        if hit.face == here:
            break
    return hit


@wp.func
def search_nearer(mesh: wp.uint64, query: wp.vec3, best: Hit) -> Hit:
    """The nearest point of the whole surface, whose hierarchy is ``mesh``, where it is nearer than ``best``."""
    hit = best
    distance = wp.sqrt(best.squared)
    found = wp.mesh_query_point_no_sign(mesh, query, distance)
    if found.result:
        hit.face = found.face
        hit.barycentric = wp.vec3(found.u, found.v, 1.0 - found.u - found.v)
    return hit


@wp.func
def hit_edge(s: Surface, t: wp.int32, half_edge: wp.int32, query: wp.vec3) -> LineHit:
    """The nearest point of one edge."""
    a = s.points[t, s.corner_vertex[half_edge]]
    b = s.points[t, half_edge_target(s.corner_vertex, half_edge)]
    hit = LineHit()
    hit.half_edge = half_edge
    hit.along = segment_parameter(query, a, b)
    hit.squared = wp.length_sq(query - a - hit.along * (b - a))
    return hit


@wp.func
def closest_border_hit(s: Surface, t: wp.int32, vertex: wp.int32, query: wp.vec3) -> LineHit:
    """The nearest point of the border downhill from a vertex; half-edge -1 where the vertex is on none."""
    hit = LineHit()
    hit.half_edge = s.border_out[vertex]
    if hit.half_edge < 0:
        return hit
    hit = hit_edge(s, t, hit.half_edge, query)
    for _ in range(MAX_STEPS):
        here = hit.half_edge
        ahead = s.border_out[half_edge_target(s.corner_vertex, here)]
        behind = s.border_in[s.corner_vertex[here]]
        if ahead >= 0:
            other = hit_edge(s, t, ahead, query)
            if other.squared < hit.squared:
                hit = other
        if behind >= 0:
            other = hit_edge(s, t, behind, query)
            if other.squared < hit.squared:
                hit = other
        if hit.half_edge == here:
            break
    return hit


@wp.func
def hit_seams_about(s: Surface, t: wp.int32, vertex: wp.int32, query: wp.vec3, best: LineHit) -> LineHit:
    """``best``, or a nearer point on the seams that end at a vertex."""
    hit = best
    for i in range(s.adjacency_start[vertex], s.adjacency_start[vertex + 1]):
        half_edge = s.adjacent_corner[i]
        if s.seam[half_edge] == 1:
            other = hit_edge(s, t, half_edge, query)
            if hit.half_edge < 0 or other.squared < hit.squared:
                hit = other
    return hit


@wp.func
def closest_seam_hit(s: Surface, t: wp.int32, vertex: wp.int32, query: wp.vec3) -> LineHit:
    """The nearest point of the seams downhill from a vertex, over forks, too; half-edge -1 where it is on none."""
    hit = LineHit()
    hit.half_edge = wp.int32(-1)
    hit = hit_seams_about(s, t, vertex, query, hit)
    if hit.half_edge < 0:
        return hit
    for _ in range(MAX_STEPS):
        here = hit.half_edge
        hit = hit_seams_about(s, t, s.corner_vertex[here], query, hit)
        hit = hit_seams_about(s, t, half_edge_target(s.corner_vertex, here), query, hit)
        if hit.half_edge == here:
            break
    return hit


@wp.func
def closest_line_hit(s: Surface, on_seams: wp.int32, t: wp.int32, vertex: wp.int32, query: wp.vec3) -> LineHit:
    """The nearest point of the seams downhill from a vertex if ``on_seams`` is 1, else of the border."""
    if on_seams == 1:
        return closest_seam_hit(s, t, vertex, query)
    return closest_border_hit(s, t, vertex, query)
