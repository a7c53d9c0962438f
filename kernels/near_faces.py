"""Faces of a mesh near to points and to pieces of triangles, in double precision; see :mod:`.distance_bound`."""

import warp as wp

from warpqem.kernels.closest_point import closest_barycentric, offset_squared

# No gradients are taken. Loops stay loops: unrolled, one inside another, they take ten times as long to compile.
wp.set_module_options({"enable_backward": False, "max_unroll": 1})

# Faces kept for each triangle that covered pieces of it before: a triangle across a vertex of the other mesh meets some
# four. Trying one takes a twentieth of a search.
HINTS = wp.constant(wp.int32(4))
Faces = wp.types.vector(length=int(HINTS), dtype=wp.int32)
# Steps from face to face towards a point, before the hierarchy is searched: each takes a fiftieth of a search.
MAX_STEPS = wp.constant(wp.int32(12))
# Faces around one that are looked through where no neighbour is nearer: those within two or three edges.
AROUND = wp.constant(wp.int32(32))
FacesAround = wp.types.vector(length=int(AROUND), dtype=wp.int32)
# The search is in single precision, which places points of a mesh of unit diagonal to some 1e-7.
SEARCH_MARGIN = wp.constant(wp.float64(1.0e-6))
# Beyond every distance; its square fits single precision.
ANYWHERE = wp.constant(wp.float64(1.0e15))


@wp.struct
class Surface:
    """A mesh of about unit size around the origin, in one frame."""

    points: wp.array[wp.vec3d]
    corner_vertex: wp.array[wp.int32]
    across: wp.array[wp.int32]  # (3N,) the face beyond the edge from each corner to the next, -1 at a border
    mesh: wp.uint64  # its hierarchy, in single precision
    first: wp.int32  # the face that is the first one of the hierarchy


@wp.struct
class CellTable:
    """Where cells begin that are one surface together: a mesh in several frames, or several meshes."""

    first_face: wp.array[wp.int32]  # (C+1,) the first face of each, and behind them how many there are
    mesh: wp.array[wp.uint64]  # (C,) the hierarchy of each; that of a mesh in several frames holds all of them
    mesh_first: wp.array[wp.int32]  # (C,) the face that is the first one of the hierarchy


@wp.func
def of_cell(surface: Surface, cells: CellTable, cell: wp.int32) -> Surface:
    """A surface with the hierarchy of one of its cells."""
    found = surface
    found.mesh = cells.mesh[cell]
    found.first = cells.mesh_first[cell]
    return found


@wp.func
def corner_point(surface: Surface, face: wp.int32, k: wp.int32) -> wp.vec3d:
    """A corner of a face."""
    return surface.points[surface.corner_vertex[3 * face + k]]


@wp.func
def squared_distance(surface: Surface, face: wp.int32, p: wp.vec3d) -> wp.float64:
    """Squared distance of a point from a face."""
    a = corner_point(surface, face, 0)
    b = corner_point(surface, face, 1)
    c = corner_point(surface, face, 2)
    return offset_squared(p, a, b, c, closest_barycentric(p, a, b, c))


@wp.func
def is_near(
    p: wp.vec3d,
    a: wp.vec3d,
    b: wp.vec3d,
    c: wp.vec3d,
    normal: wp.vec3d,
    normal_squared: wp.float64,
    squared: wp.float64,
) -> wp.bool:
    """Whether a point is within a distance, given squared, of triangle abc; ``normal`` is (b - a) x (c - a)."""
    ap = p - a
    height = wp.dot(ap, normal)
    # No point of the triangle is nearer than its plane.
    if height * height > squared * normal_squared:
        return False
    v = wp.dot(wp.cross(ap, c - a), normal)
    w = wp.dot(wp.cross(b - a, ap), normal)
    if v >= wp.float64(0.0) and w >= wp.float64(0.0) and v + w < normal_squared:
        return True
    return offset_squared(p, a, b, c, closest_barycentric(p, a, b, c)) <= squared


@wp.func
def covers(surface: Surface, face: wp.int32, p: wp.vec3d, q: wp.vec3d, r: wp.vec3d, limit: wp.float64) -> wp.bool:
    """Whether a face is within the limit of all points of a piece."""
    squared = limit * limit
    a = corner_point(surface, face, 0)
    b = corner_point(surface, face, 1)
    c = corner_point(surface, face, 2)
    normal = wp.cross(b - a, c - a)
    normal_squared = wp.length_sq(normal)
    if not is_near(p, a, b, c, normal, normal_squared, squared):
        return False
    if not is_near(q, a, b, c, normal, normal_squared, squared):
        return False
    return is_near(r, a, b, c, normal, normal_squared, squared)


@wp.func
def nearest_face(surface: Surface, p: wp.vec3d, limit: wp.float64) -> wp.int32:
    """The face nearest to a point, -1 where none is within the limit."""
    radius = wp.float32(limit + SEARCH_MARGIN)
    found = wp.mesh_query_point_no_sign(
        surface.mesh, wp.vec3(wp.float32(p[0]), wp.float32(p[1]), wp.float32(p[2])), radius
    )
    if found.result:
        return surface.first + found.face
    return -1


@wp.func
def nearer_face(other: Surface, best: wp.int32, best_squared: wp.float64, p: wp.vec3d) -> wp.int32:
    """The face nearest to a point, where one is known at a squared distance, or -1."""
    radius = wp.float32(wp.sqrt(best_squared) + SEARCH_MARGIN)
    found = wp.mesh_query_point_no_sign(
        other.mesh, wp.vec3(wp.float32(p[0]), wp.float32(p[1]), wp.float32(p[2])), radius
    )
    nearest = best
    if found.result:  # noqa: SIM102 - a kernel evaluates both sides of an "and", and there may be no face
        # In single precision, the search may prefer the other one of two faces.
        if squared_distance(other, other.first + found.face, p) < best_squared:
            nearest = other.first + found.face
    return nearest


@wp.func
def exactly_nearest(other: Surface, near: wp.int32, squared: wp.float64, p: wp.vec3d) -> wp.int32:
    """The face nearest to a point in double precision, the first of equal ones; one is known at a squared distance."""
    best = near
    best_squared = squared
    centre = wp.vec3(wp.float32(p[0]), wp.float32(p[1]), wp.float32(p[2]))
    reach = wp.float32(wp.sqrt(squared) + SEARCH_MARGIN)
    extent = wp.vec3(reach, reach, reach)
    query = wp.mesh_query_aabb(other.mesh, centre - extent, centre + extent)
    here = wp.int32(0)
    while wp.mesh_query_next(query, here):
        face = other.first + here
        found = squared_distance(other, face, p)
        if found < best_squared or (found == best_squared and face < best):
            best = face
            best_squared = found
    return best


@wp.struct
class Nearest:
    """The point of a face nearest to another point."""

    weights: wp.vec3d  # of the corners of the face
    squared: wp.float64  # the squared distance


@wp.func
def nearest_on_face(surface: Surface, face: wp.int32, p: wp.vec3d) -> Nearest:
    """The point of a face nearest to another point: the foot on its plane, where that lies inside."""
    found = Nearest()
    a = corner_point(surface, face, 0)
    ab = corner_point(surface, face, 1) - a
    ac = corner_point(surface, face, 2) - a
    ap = p - a
    normal = wp.cross(ab, ac)
    normal_squared = wp.length_sq(normal)
    v = wp.dot(wp.cross(ap, ac), normal)
    w = wp.dot(wp.cross(ab, ap), normal)
    if v > wp.float64(0.0) and w > wp.float64(0.0) and v + w < normal_squared:
        v /= normal_squared
        w /= normal_squared
        found.weights = wp.vec3d(wp.float64(1.0) - v - w, v, w)
    else:
        found.weights = closest_barycentric(p, a, a + ab, a + ac)
    offset = ap - found.weights[1] * ab - found.weights[2] * ac
    found.squared = wp.length_sq(offset)
    return found


@wp.struct
class NearFace:
    """A face near to a point."""

    face: wp.int32  # -1 for none
    squared: wp.float64  # the squared distance


@wp.func
def face_towards(surface: Surface, start: wp.int32, p: wp.vec3d) -> NearFace:
    """A face that no neighbour across an edge is nearer than to a point, from ``start`` on, or one on the way there."""
    face = start
    here = nearest_on_face(surface, face, p)
    steps = wp.int32(0)
    while steps < MAX_STEPS:
        steps += 1
        nearer = wp.int32(-1)
        there = here
        for k in range(3):
            # The closest point lies on this edge.
            if nearer < 0 and here.weights[(k + 2) % 3] <= wp.float64(0.0):
                next_face = surface.across[3 * face + k]
                if next_face >= 0:
                    there = nearest_on_face(surface, next_face, p)
                    if there.squared < here.squared:
                        nearer = next_face
        if nearer < 0:
            steps = MAX_STEPS
        else:
            face = nearer
            here = there
    found = NearFace()
    found.face = face
    found.squared = here.squared
    return found


@wp.func
def face_around(surface: Surface, start: NearFace, p: wp.vec3d) -> NearFace:
    """The face nearest to a point of those around a face, breadth first across edges."""
    around = FacesAround()
    around[0] = start.face
    count = wp.int32(1)
    nearest = start
    i = wp.int32(0)
    while i < count:
        for k in range(3):
            face = surface.across[3 * around[i] + k]
            is_new = face >= 0 and count < AROUND
            for j in range(count):
                if around[j] == face:
                    is_new = False
            if is_new:
                around[count] = face
                count += 1
                found = nearest_on_face(surface, face, p)
                if found.squared < nearest.squared:
                    nearest.face = face
                    nearest.squared = found.squared
        i += 1
    return nearest


@wp.func
def with_first(hints: Faces, face: wp.int32, place: wp.int32) -> Faces:
    """The hints with a face in front, and those before ``place`` one further back."""
    moved = hints
    for back in range(HINTS - 1):
        i = HINTS - 1 - back
        if i <= place:
            moved[i] = hints[i - 1]
    moved[0] = face
    return moved


@wp.func
def with_face(hints: Faces, face: wp.int32) -> Faces:
    """The hints with a face in front, which may be one of them."""
    place = HINTS - 1
    for k in range(HINTS):
        if hints[k] == face:
            place = k
    return with_first(hints, face, place)
