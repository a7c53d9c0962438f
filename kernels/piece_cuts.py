"""Pieces of triangles, and how they are cut: over the edges of a face of another mesh, or in half."""

import warp as wp

from warpqem.kernels.near_faces import Surface, corner_point

# No gradients are taken. Loops stay loops: unrolled, one inside another, they take ten times as long to compile.
wp.set_module_options({"enable_backward": False, "max_unroll": 1})

# Corners as near to a plane as that, in areas, lie on it.
ON_PLANE = wp.constant(wp.float64(1.0e-13))
Corners = wp.types.matrix(shape=(3, 3), dtype=wp.float64)  # of a piece, a row each
Places = wp.types.matrix(shape=(3, 2), dtype=wp.float64)  # of them: weights of the owner's second and third corner


@wp.struct
class Cut:
    """How a piece is cut: from the edge to the corner after ``corner`` to the edge to the one before it."""

    corner: wp.int32
    after: wp.float64  # how far along the edge to the next corner
    before: wp.float64  # how far along the edge to the previous corner
    in_three: wp.bool  # else in half, through the corner before
    edge: wp.int32  # of the face, where the cut is over one
    is_beyond: wp.bool  # whether the corner is beyond the cut, and the rest before it, or the other way round


@wp.func
def cut_at_zero(side: wp.vec3d) -> Cut:
    """The cut where a number is 0 that is linear between the corners, and not of one sign."""
    cut = Cut()
    cut.in_three = wp.bool(True)
    # The corner alone on its side.
    for k in range(3):
        own_side = side[k] > wp.float64(0.0)
        if own_side != (side[(k + 1) % 3] > wp.float64(0.0)) and own_side != (side[(k + 2) % 3] > wp.float64(0.0)):
            cut.corner = k
    own = side[cut.corner]
    cut.is_beyond = own > wp.float64(0.0)
    cut.after = own / (own - side[(cut.corner + 1) % 3])
    cut.before = own / (own - side[(cut.corner + 2) % 3])
    return cut


@wp.func
def cut_over_edge(other: Surface, face: wp.int32, corners: Corners) -> Cut:
    """The cut at the plane over that edge of a face beyond which the piece reaches furthest, if it is ``in_three``."""
    cut = Cut()
    cut.in_three = wp.bool(False)
    a = corner_point(other, face, 0)
    normal = wp.cross(corner_point(other, face, 1) - a, corner_point(other, face, 2) - a)
    furthest = ON_PLANE
    for edge in range(3):
        start = corner_point(other, face, edge)
        outward = wp.normalize(wp.cross(corner_point(other, face, (edge + 1) % 3) - start, normal))
        side = wp.vec3d()
        for k in range(3):
            side[k] = wp.dot(corners[k] - start, outward)
        most = wp.max(side[0], wp.max(side[1], side[2]))
        if most > furthest and wp.min(side[0], wp.min(side[1], side[2])) < -ON_PLANE:
            furthest = most
            cut = cut_at_zero(side)
            cut.edge = edge
    return cut


@wp.func
def cut_in_half(corners: Corners) -> Cut:
    """The cut across the longest edge, to the corner opposite to it."""
    cut = Cut()
    cut.in_three = wp.bool(False)
    longest = wp.float64(-1.0)
    for k in range(3):
        length = wp.length_sq(corners[(k + 1) % 3] - corners[k])
        if length > longest:
            longest = length
            cut.corner = k
    cut.after = wp.float64(0.5)
    cut.before = wp.float64(1.0)
    return cut


@wp.func
def cut_part(places: Places, cut: Cut, index: wp.int32) -> Places:
    """One of the parts of a piece that is cut, two or three of them; the first one has the corner of the cut."""
    p = places[cut.corner]
    q = places[(cut.corner + 1) % 3]
    r = places[(cut.corner + 2) % 3]
    one = p + cut.after * (q - p)
    two = p + cut.before * (r - p)
    if index == 0:
        return Places(p[0], p[1], one[0], one[1], two[0], two[1])
    if index == 1:
        return Places(one[0], one[1], q[0], q[1], r[0], r[1])
    return Places(one[0], one[1], r[0], r[1], two[0], two[1])
