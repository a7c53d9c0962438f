"""The material frame at an output vertex: its normal and two tangents that deform with the surface.

A correction that is constant in this frame moves with the surface: it bends, turns, stretches and grows as the surface
does, and adds no motion of its own.
"""

import warp as wp

from warpqem.kernels.topology import half_edge_target

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# Regularisation of the tangents towards the similarity that fits best, relative to the spread of the ring's edges. A
# ring that is nearly a line in the reference frame says nothing about stretch across it.
SIMILARITY_REGULARISATION = wp.constant(wp.float32(0.05))

# A normal or a ring smaller than this (areas and squared lengths on a mesh of unit diagonal) has no direction.
NO_EXTENT = wp.constant(wp.float32(1.0e-30))


@wp.struct
class OneRings:
    """The faces about each of C output vertices, and the pose that material frames start from."""

    corner_vertex: wp.array[wp.int32]  # (3N',)
    adjacency_start: wp.array[wp.int32]  # (C+1,)
    adjacent_corner: wp.array[wp.int32]  # (3N',)
    reference: wp.array[wp.vec3]  # (C,) positions in the reference frame
    reference_normal: wp.array[wp.vec3]  # (C,) of any length


@wp.func
def first_tangent(n: wp.vec3) -> wp.vec3:
    """A unit vector across the unit vector ``n``."""
    axis = wp.vec3(1.0, 0.0, 0.0)
    if wp.abs(n[0]) > 0.7:
        axis = wp.vec3(0.0, 1.0, 0.0)
    return wp.normalize(wp.cross(axis, n))


@wp.func
def material_frame(
    rings: OneRings, points: wp.array2d[wp.vec3], normals: wp.array2d[wp.vec3], t: wp.int32, c: wp.int32
) -> wp.mat33:
    """Columns: the two reference tangents, deformed, and the normal; all zero where there is no normal.

    The normal is as long as lengths around the vertex have become in the mean, the root of the stretch of areas: how
    far a surface lies from its chords grows with it.

    The tangents follow the map of the tangent plane that fits the ring's edges best, from the reference frame to frame
    ``t``: ``B = (M + r R) (G + r I)^-1``, with ``M = sum u u0^T``, ``G = sum u0 u0^T`` over edges ``u0`` that become
    ``u``, ``R`` the best similarity, rotation and growth, and ``r`` a small part of ``tr G``. A surface that only turns
    and grows has frames that do the same, whatever its rings.
    """
    if wp.length(normals[t, c]) < NO_EXTENT or wp.length(rings.reference_normal[c]) < NO_EXTENT:
        return wp.mat33()
    n = wp.normalize(normals[t, c])
    x = first_tangent(n)
    y = wp.cross(n, x)
    n0 = wp.normalize(rings.reference_normal[c])
    x0 = first_tangent(n0)
    y0 = wp.cross(n0, x0)
    m = wp.mat22()
    g = wp.mat22()
    for i in range(rings.adjacency_start[c], rings.adjacency_start[c + 1]):
        v = half_edge_target(rings.corner_vertex, rings.adjacent_corner[i])
        d = points[t, v] - points[t, c]
        d0 = rings.reference[v] - rings.reference[c]
        u = wp.vec2(wp.dot(d, x), wp.dot(d, y))
        u0 = wp.vec2(wp.dot(d0, x0), wp.dot(d0, y0))
        m += wp.outer(u, u0)
        g += wp.outer(u0, u0)
    cosine = m[0, 0] + m[1, 1]
    sine = m[1, 0] - m[0, 1]
    length = wp.sqrt(cosine * cosine + sine * sine)
    spread = wp.trace(g)
    b = wp.identity(n=2, dtype=wp.float32)
    if length > NO_EXTENT and spread > NO_EXTENT:
        # Divided by the spread, so that the determinant stays far from the smallest floats.
        similarity = wp.mat22(cosine, -sine, sine, cosine) / spread
        b = (m / spread + SIMILARITY_REGULARISATION * similarity) * wp.inverse(
            g / spread + SIMILARITY_REGULARISATION * wp.identity(n=2, dtype=wp.float32)
        )
    e = b[0, 0] * x + b[1, 0] * y
    f = b[0, 1] * x + b[1, 1] * y
    h = wp.sqrt(wp.abs(wp.determinant(b))) * n
    return wp.mat33(e[0], f[0], h[0], e[1], f[1], h[1], e[2], f[2], h[2])


@wp.kernel
def measure_material_frames(
    # in
    rings: OneRings,
    points_in: wp.array2d[wp.vec3],
    normal_in: wp.array2d[wp.vec3],
    free_in: wp.array[wp.int32],
    # out
    frame_out: wp.array2d[wp.mat33],
):
    """Material frames (B, C) of a block of frames with points and normals (B, C); zero for vertices that must stay."""
    t, c = wp.tid()
    frame = wp.mat33()
    if free_in[c] == 1:
        frame = material_frame(rings, points_in, normal_in, t, c)
    frame_out[t, c] = frame


@wp.kernel
def move_by_corrections(
    # in
    points_in: wp.array2d[wp.vec3],
    frame_in: wp.array2d[wp.mat33],
    correction_in: wp.array[wp.vec3],
    # out
    points_out: wp.array2d[wp.vec3],
):
    """Each vertex moved by its correction (C,), the same in all frames (B, C) as the material sees it."""
    t, c = wp.tid()
    x = points_in[t, c]
    d = correction_in[c]
    if wp.dot(d, d) > 0.0:
        x += frame_in[t, c] * d
    points_out[t, c] = x


@wp.kernel
def mark_long_corrections(
    # in
    correction_in: wp.array[wp.vec3],
    largest_squared_in: wp.array[wp.float32],
    # out
    marked_out: wp.array[wp.int32],
):
    """1 at vertices (C,) that go further than a length, given squared in (n,), first of all."""
    v = wp.tid()
    marked_out[v] = wp.where(wp.length_sq(correction_in[v]) > largest_squared_in[0], 1, 0)


@wp.kernel
def scale_corrections(
    # in
    factor_in: wp.array[wp.float32],
    # in and out
    correction: wp.array[wp.vec3],
):
    """Multiply what each vertex (C,) does."""
    v = wp.tid()
    correction[v] = factor_in[v] * correction[v]


@wp.kernel
def mark_new_flips(
    # in
    points_in: wp.array2d[wp.vec3],
    moved_in: wp.array2d[wp.vec3],
    normal_in: wp.array2d[wp.vec3],
    correction_in: wp.array[wp.vec3],
    corner_vertex_in: wp.array[wp.int32],
    # out
    marked_out: wp.array[wp.int32],
):
    """Mark the moved vertices of faces that turn over by the move (every thread writes the same value)."""
    t, f = wp.tid()
    a = corner_vertex_in[3 * f]
    b = corner_vertex_in[3 * f + 1]
    c = corner_vertex_in[3 * f + 2]
    outside = normal_in[t, a] + normal_in[t, b] + normal_in[t, c]
    before = wp.cross(points_in[t, b] - points_in[t, a], points_in[t, c] - points_in[t, a])
    after = wp.cross(moved_in[t, b] - moved_in[t, a], moved_in[t, c] - moved_in[t, a])
    if wp.dot(after, outside) < 0.0 and wp.dot(before, outside) >= 0.0:
        for k in range(3):
            v = corner_vertex_in[3 * f + k]
            if wp.dot(correction_in[v], correction_in[v]) > 0.0:
                marked_out[v] = 1
