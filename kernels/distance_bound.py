"""Whether every point of a triangle lies within a limit of a mesh: proved, not sampled.

The distance to one triangle is convex, so over a piece of another triangle it is largest at a corner of the piece. A
piece is within the limit where one triangle of the mesh is within it at all three corners, or where its middle is
nearer by more than its corners are away (the distance to a mesh changes by no more than one moves). Other pieces are
cut where the triangle nearest to their middle ends, so that what lies over it is a piece of its own; where that does
not cut them, in half.
"""

import warp as wp

from warpqem.kernels.closest_point import closest_barycentric, offset_squared

# No gradients are taken. Loops stay loops: unrolled, one inside another, they take ten times as long to compile.
wp.set_module_options({"enable_backward": False, "max_unroll": 1})

WITHIN = wp.constant(wp.int32(0))
BEYOND = wp.constant(wp.int32(1))  # a point beyond the limit was found
UNDECIDED = wp.constant(wp.int32(2))  # neither, down to the smallest pieces
NO_ROOM = wp.constant(wp.int32(3))  # within, and not all pieces are written
# Pieces of a triangle that are looked at, and that may wait, before it is given up as undecided.
MAX_PIECES = wp.constant(wp.int32(4096))
MAX_WAITING = wp.constant(wp.int32(40))
Waiting = wp.types.matrix(shape=(int(MAX_WAITING), 9), dtype=wp.float64)
# Corners as near to a plane as that, in areas, lie on it.
ON_PLANE = wp.constant(wp.float64(1.0e-13))
# Faces kept for each triangle that covered pieces of it before: a triangle across a vertex of the other mesh meets some
# four. Trying one takes a twentieth of a search.
HINTS = wp.constant(wp.int32(4))
Faces = wp.types.vector(length=int(HINTS), dtype=wp.int32)
# Steps from face to face towards a point, before the hierarchy is searched: each takes a fiftieth of a search.
MAX_STEPS = wp.constant(wp.int32(12))
# The search is in single precision, which places points of a mesh of unit diagonal to some 1e-7.
SEARCH_MARGIN = wp.constant(wp.float64(1.0e-6))


@wp.struct
class Surface:
    """A mesh of about unit size around the origin, in one frame."""

    points: wp.array[wp.vec3d]
    corner_vertex: wp.array[wp.int32]
    across: wp.array[wp.int32]  # (3N,) the face beyond the edge from each corner to the next, -1 at a border
    mesh: wp.uint64  # its hierarchy, in single precision


@wp.struct
class Pieces:
    """Pieces of triangles, each within the limit of one face of the other mesh."""

    owner: wp.array[wp.int32]  # (M,) the triangle
    face: wp.array[wp.int32]  # (M,) the face
    # (M, 3, 4) of each corner, the weights of the owner's second and third corner, and of the face's at the point there
    # that is nearest to it
    weight: wp.array3d[wp.float32]


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
        return found.face
    return -1


@wp.func
def face_towards(surface: Surface, start: wp.int32, p: wp.vec3d) -> wp.int32:
    """A face that no neighbour across an edge is nearer than to a point, from ``start`` on, or one on the way there."""
    face = start
    weights = closest_barycentric(
        p, corner_point(surface, face, 0), corner_point(surface, face, 1), corner_point(surface, face, 2)
    )
    squared = squared_distance(surface, face, p)
    steps = wp.int32(0)
    while steps < MAX_STEPS:
        steps += 1
        nearer = wp.int32(-1)
        for k in range(3):
            # The closest point lies on this edge.
            if nearer < 0 and weights[(k + 2) % 3] <= wp.float64(0.0):
                next_face = surface.across[3 * face + k]
                if next_face >= 0:
                    found = squared_distance(surface, next_face, p)
                    if found < squared:
                        nearer = next_face
                        squared = found
        if nearer < 0:
            steps = MAX_STEPS
        else:
            face = nearer
            weights = closest_barycentric(
                p, corner_point(surface, face, 0), corner_point(surface, face, 1), corner_point(surface, face, 2)
            )
    return face


@wp.struct
class Piece:
    """A part of a triangle, by its corners."""

    p: wp.vec3d
    q: wp.vec3d
    r: wp.vec3d


@wp.struct
class Cut:
    """Where a plane cuts a piece: its corners in order from the one alone on its side, and how far along both edges."""

    piece: Piece
    first: wp.float64
    second: wp.float64
    found: wp.bool


@wp.func
def cut_at_edges(surface: Surface, face: wp.int32, piece: Piece) -> Cut:
    """The cut at the plane over that edge of a face beyond which the piece reaches furthest."""
    cut = Cut()
    cut.piece = piece
    cut.found = wp.bool(False)
    a = corner_point(surface, face, 0)
    normal = wp.cross(corner_point(surface, face, 1) - a, corner_point(surface, face, 2) - a)
    furthest = ON_PLANE
    for k in range(3):
        start = corner_point(surface, face, k)
        outward = wp.normalize(wp.cross(corner_point(surface, face, (k + 1) % 3) - start, normal))
        side = wp.vec3d(
            wp.dot(piece.p - start, outward), wp.dot(piece.q - start, outward), wp.dot(piece.r - start, outward)
        )
        most = wp.max(side[0], wp.max(side[1], side[2]))
        least = wp.min(side[0], wp.min(side[1], side[2]))
        if most > furthest and least < -ON_PLANE:
            furthest = most
            cut.found = wp.bool(True)
            # The corner alone on its side.
            alone = wp.int32(0)
            for i in range(3):
                before = side[(i + 1) % 3]
                after = side[(i + 2) % 3]
                own_side = side[i] > wp.float64(0.0)
                if own_side != (before > wp.float64(0.0)) and own_side != (after > wp.float64(0.0)):
                    alone = i
            if alone == 0:
                cut.piece = piece
            elif alone == 1:
                cut.piece.p = piece.q
                cut.piece.q = piece.r
                cut.piece.r = piece.p
            else:
                cut.piece.p = piece.r
                cut.piece.q = piece.p
                cut.piece.r = piece.q
            own = side[alone]
            cut.first = own / (own - side[(alone + 1) % 3])
            cut.second = own / (own - side[(alone + 2) % 3])
    return cut


@wp.func
def cut_in_half(piece: Piece) -> Cut:
    """The cut across the longest edge, through the corner opposite to it."""
    cut = Cut()
    cut.piece = piece
    pq = wp.length_sq(piece.p - piece.q)
    qr = wp.length_sq(piece.q - piece.r)
    rp = wp.length_sq(piece.r - piece.p)
    # The longest edge becomes that from p to q.
    if qr >= pq and qr >= rp:
        cut.piece.p = piece.q
        cut.piece.q = piece.r
        cut.piece.r = piece.p
    elif rp >= pq and rp >= qr:
        cut.piece.p = piece.r
        cut.piece.q = piece.p
        cut.piece.r = piece.q
    cut.first = wp.float64(0.5)
    cut.second = wp.float64(1.0)
    cut.found = wp.bool(False)
    return cut


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
def write_corner(pieces: Pieces, index: wp.int32, k: wp.int32, own: Surface, other: Surface, p: wp.vec3d):
    """Write the weights of a corner of a piece."""
    owner = pieces.owner[index]
    face = pieces.face[index]
    here = closest_barycentric(p, corner_point(own, owner, 0), corner_point(own, owner, 1), corner_point(own, owner, 2))
    there = closest_barycentric(
        p, corner_point(other, face, 0), corner_point(other, face, 1), corner_point(other, face, 2)
    )
    pieces.weight[index, k, 0] = wp.float32(here[1])
    pieces.weight[index, k, 1] = wp.float32(here[2])
    pieces.weight[index, k, 2] = wp.float32(there[1])
    pieces.weight[index, k, 3] = wp.float32(there[2])


@wp.func
def piece_corner(pieces: Pieces, index: wp.int32, k: wp.int32, own: Surface) -> wp.vec3d:
    """A corner of a piece, where its owner is now."""
    owner = pieces.owner[index]
    a = corner_point(own, owner, 0)
    ab = corner_point(own, owner, 1) - a
    ac = corner_point(own, owner, 2) - a
    return a + wp.float64(pieces.weight[index, k, 0]) * ab + wp.float64(pieces.weight[index, k, 1]) * ac


@wp.struct
class Outcome:
    """A verdict, and the faces that covered pieces."""

    verdict: wp.int32
    hints: Faces


@wp.func
def bound_piece(
    whole: Piece,
    own: Surface,
    other: Surface,
    limit: wp.float64,
    hints_in: Faces,
    searching: wp.bool,
    owner: wp.int32,
    used: wp.array[wp.int32],
    pieces_out: Pieces,
) -> Outcome:
    """Whether a piece is within the limit of a mesh; its parts are written where there is room for any.

    Without ``searching``, faces are found from those next to them alone, and UNDECIDED is what that does not show.
    """
    hints = hints_in
    room = pieces_out.owner.shape[0]
    verdict = wp.int32(WITHIN)
    waiting = Waiting()
    for k in range(3):
        waiting[0, k] = whole.p[k]
        waiting[0, 3 + k] = whole.q[k]
        waiting[0, 6 + k] = whole.r[k]
    count = wp.int32(1)
    looked_at = wp.int32(0)
    while count > 0:
        count -= 1
        looked_at += 1
        piece = Piece()
        piece.p = wp.vec3d(waiting[count, 0], waiting[count, 1], waiting[count, 2])
        piece.q = wp.vec3d(waiting[count, 3], waiting[count, 4], waiting[count, 5])
        piece.r = wp.vec3d(waiting[count, 6], waiting[count, 7], waiting[count, 8])
        centre = (piece.p + piece.q + piece.r) / wp.float64(3.0)
        cut = Cut()
        covered = wp.bool(False)
        done = wp.bool(False)
        # First the faces that were near before, then the one where a walk from the last of them ends, then a search.
        attempt = wp.int32(0)
        last = HINTS + wp.where(searching, 1, 0)
        while attempt <= last and not done:
            near = wp.int32(-1)
            if attempt < HINTS:
                near = hints[attempt]
            elif attempt == HINTS:
                if hints[0] >= 0:
                    near = face_towards(other, hints[0], centre)
            else:
                near = nearest_face(other, centre, limit)
            if near >= 0:
                covered = covers(other, near, piece.p, piece.q, piece.r, limit)
            if covered:
                hints = with_first(hints, near, wp.min(attempt, HINTS - 1))
                done = True
            elif attempt >= HINTS and near >= 0:
                squared = squared_distance(other, near, centre)
                if squared <= limit * limit:
                    size = wp.max(
                        wp.length_sq(piece.p - centre),
                        wp.max(wp.length_sq(piece.q - centre), wp.length_sq(piece.r - centre)),
                    )
                    if wp.sqrt(squared) + wp.sqrt(size) <= limit:
                        covered = True
                        done = True
                    else:
                        cut = cut_at_edges(other, near, piece)
                        done = cut.found
                    hints = with_first(hints, near, HINTS - 1)
                    if not done and attempt == last:
                        cut = cut_in_half(piece)
                        done = True
            attempt += 1
        if not done:
            verdict = wp.where(searching, BEYOND, UNDECIDED)
        elif covered:
            if room > 0 and not write_piece(pieces_out, room, used, owner, hints[0], own, other, piece):
                verdict = wp.where(verdict == WITHIN, NO_ROOM, verdict)
        elif looked_at == MAX_PIECES or count + 3 > MAX_WAITING:
            verdict = UNDECIDED
        else:
            one = cut.piece.p + (cut.piece.q - cut.piece.p) * cut.first
            two = cut.piece.p + (cut.piece.r - cut.piece.p) * cut.second
            for k in range(3):
                waiting[count, k] = cut.piece.p[k]
                waiting[count, 3 + k] = one[k]
                waiting[count, 6 + k] = two[k]
                waiting[count + 1, k] = one[k]
                waiting[count + 1, 3 + k] = cut.piece.q[k]
                waiting[count + 1, 6 + k] = cut.piece.r[k]
                waiting[count + 2, k] = one[k]
                waiting[count + 2, 3 + k] = cut.piece.r[k]
                waiting[count + 2, 6 + k] = two[k]
            # In half, there is no third.
            count += wp.where(cut.found, 3, 2)
        if verdict == BEYOND or verdict == UNDECIDED:  # noqa: SIM109
            count = 0
    outcome = Outcome()
    outcome.verdict = verdict
    outcome.hints = hints
    return outcome


@wp.func
def write_piece(
    pieces: Pieces,
    room: wp.int32,
    used: wp.array[wp.int32],
    owner: wp.int32,
    face: wp.int32,
    own: Surface,
    other: Surface,
    piece: Piece,
) -> wp.bool:
    """Add a piece, if there is room."""
    index = wp.atomic_add(used, 0, 1)
    if index >= room:
        return False
    pieces.owner[index] = owner
    pieces.face[index] = face
    write_corner(pieces, index, 0, own, other, piece.p)
    write_corner(pieces, index, 1, own, other, piece.q)
    write_corner(pieces, index, 2, own, other, piece.r)
    return True


@wp.kernel
def bound_triangles(
    # in
    own: Surface,
    other: Surface,
    limit: wp.float64,
    searching: wp.bool,
    chosen: wp.array[wp.int32],
    # in and out
    hint: wp.array2d[wp.int32],
    used: wp.array[wp.int32],
    # out
    pieces_out: Pieces,
    verdict_out: wp.array[wp.int32],
):
    """Whether some faces of ``own``, ``chosen`` (n,), are within the limit of ``other``, see :func:`bound_piece`.

    ``hint`` (N, HINTS) are faces of ``other`` that covered pieces of it before, the last one first, -1 for none. Pieces
    are written from the ``used``-th (1,) on as long as there is room for them.
    """
    i = wp.tid()
    face = chosen[i]
    whole = Piece()
    whole.p = corner_point(own, face, 0)
    whole.q = corner_point(own, face, 1)
    whole.r = corner_point(own, face, 2)
    hints = Faces()
    for k in range(HINTS):
        hints[k] = hint[face, k]
    outcome = bound_piece(whole, own, other, limit, hints, searching, face, used, pieces_out)
    for k in range(HINTS):
        hint[face, k] = outcome.hints[k]
    verdict_out[i] = outcome.verdict


@wp.kernel
def bound_pieces(
    # in
    own_points: wp.array2d[wp.vec3d],
    other_points: wp.array2d[wp.vec3d],
    own_in: Surface,
    other_in: Surface,
    limit: wp.float64,
    pieces: Pieces,
    chosen: wp.array[wp.int32],
    frame: wp.array[wp.int32],
    no_pieces: Pieces,
    # in and out
    used: wp.array[wp.int32],
    # out
    verdict_out: wp.array[wp.int32],
):
    """Whether some pieces, ``chosen`` (n,), are within the limit in the frames (n,), without a search.

    Points are (F, V) and (F, W).
    """
    i = wp.tid()
    index = chosen[i]
    own = own_in
    other = other_in
    own.points = own_points[frame[i]]
    other.points = other_points[frame[i]]
    piece = Piece()
    piece.p = piece_corner(pieces, index, 0, own)
    piece.q = piece_corner(pieces, index, 1, own)
    piece.r = piece_corner(pieces, index, 2, own)
    hints = Faces()
    for k in range(HINTS):
        hints[k] = -1
    hints[0] = pieces.face[index]
    outcome = bound_piece(piece, own, other, limit, hints, False, pieces.owner[index], used, no_pieces)
    verdict_out[i] = outcome.verdict
