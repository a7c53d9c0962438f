"""Whether every point of a triangle lies within a limit of a mesh: proved, not sampled.

The distance to one triangle is convex, so over a piece of another triangle it is largest at a corner of the piece. A
piece is within the limit where one triangle of the mesh is within it at all three corners, or where its middle is
nearer by more than its corners are away (the distance to a mesh changes by no more than one moves). Other pieces are
cut where the triangle nearest to their middle ends, so that what lies over it is a piece of its own; where that does
not cut them, in half.
"""

import warp as wp

from warpqem.kernels.near_faces import (
    ANYWHERE,
    HINTS,
    Faces,
    NearFace,
    Surface,
    corner_point,
    covers,
    face_around,
    face_towards,
    nearest_face,
    nearest_on_face,
    with_face,
)
from warpqem.kernels.piece_cuts import Corners, Cut, Places, cut_in_half, cut_over_edge, cut_part

# No gradients are taken. Loops stay loops: unrolled, one inside another, they take ten times as long to compile.
wp.set_module_options({"enable_backward": False, "max_unroll": 1})

WITHIN = wp.constant(wp.int32(0))
BEYOND = wp.constant(wp.int32(1))  # a point beyond the limit was found
UNDECIDED = wp.constant(wp.int32(2))  # neither, down to the smallest pieces
NO_ROOM = wp.constant(wp.int32(3))  # within, and not all pieces are written
# How near faces are looked for: from neighbour to neighbour; among those around, too; or in the whole mesh.
WALK = wp.constant(wp.int32(0))
AROUND = wp.constant(wp.int32(1))
SEARCH = wp.constant(wp.int32(2))
# Pieces of a triangle that are looked at, and that may wait, before it is given up as undecided.
MAX_PIECES = wp.constant(wp.int32(4096))
MAX_WAITING = wp.constant(wp.int32(40))
Waiting = wp.types.matrix(shape=(int(MAX_WAITING), 6), dtype=wp.float64)
WaitingFaces = wp.types.vector(length=int(MAX_WAITING), dtype=wp.int32)


@wp.struct
class Pieces:
    """Pieces of triangles, each within the limit of one face of the other mesh."""

    parent: wp.array[wp.int32]  # (M,) the thread that wrote it
    owner: wp.array[wp.int32]  # (M,) the triangle
    face: wp.array[wp.int32]  # (M,) the face
    # (M, 3, 4) of each corner, the weights of the owner's second and third corner, and of the face's at the point there
    # that is nearest to it
    weight: wp.array3d[wp.float32]


@wp.struct
class Outcome:
    """What was found of a piece or a triangle, and the faces that covered pieces."""

    verdict: wp.int32
    hints: Faces


@wp.struct
class Look:
    """What a look at a piece gave: covered, or how to cut it, or neither."""

    covered: wp.bool
    is_cut: wp.bool
    cut: Cut
    near: wp.int32  # the face that covers it, or over which it is cut


@wp.func
def face_searched(other: Surface, centre: wp.vec3d, limit: wp.float64) -> NearFace:
    """The face nearest to a point, -1 where none is within the limit."""
    near = NearFace()
    near.face = nearest_face(other, centre, limit)
    near.squared = ANYWHERE
    if near.face >= 0:
        found = nearest_on_face(other, near.face, centre)
        near.squared = found.squared
    return near


@wp.func
def face_near(
    other: Surface, start: wp.int32, hints: Faces, centre: wp.vec3d, limit: wp.float64, effort: wp.int32
) -> NearFace:
    """A face within the limit of a point, -1 for none: where a walk from ``start`` ends, or what is looked at then."""
    squared = limit * limit
    near = NearFace()
    near.face = wp.int32(-1)
    near.squared = ANYWHERE
    if start >= 0:
        near = face_towards(other, start, centre)
    if near.squared > squared:
        # The faces that covered pieces before may lie across a fold.
        for k in range(HINTS):
            if hints[k] >= 0:
                found = nearest_on_face(other, hints[k], centre)
                if found.squared < near.squared:
                    near.face = hints[k]
                    near.squared = found.squared
    if near.squared > squared and near.face >= 0 and effort == AROUND:
        near = face_around(other, near, centre)
    if near.squared > squared and effort == SEARCH:
        near = face_searched(other, centre, limit)
    if near.squared > squared:
        near.face = wp.int32(-1)
    return near


@wp.func
def is_inside(corners: Corners, centre: wp.vec3d, squared: wp.float64, limit: wp.float64) -> wp.bool:
    """Whether a piece is within the limit as its middle is within a distance, given squared."""
    size = wp.max(
        wp.length_sq(corners[0] - centre), wp.max(wp.length_sq(corners[1] - centre), wp.length_sq(corners[2] - centre))
    )
    return wp.sqrt(squared) + wp.sqrt(size) <= limit


@wp.func
def look_over(
    corners: Corners,
    centre: wp.vec3d,
    other: Surface,
    near: NearFace,
    tried: wp.int32,
    hints: Faces,
    limit: wp.float64,
) -> Look:
    """Whether a face near to the middle of a piece covers it, or one of the ``hints``, or else how it is cut there.

    ``tried`` does not cover it.
    """
    look = Look()
    look.near = near.face
    look.is_cut = wp.bool(False)
    look.covered = is_inside(corners, centre, near.squared, limit)
    if not look.covered and near.face != tried:
        look.covered = covers(other, near.face, corners[0], corners[1], corners[2], limit)
    for k in range(HINTS):
        if not look.covered and hints[k] >= 0 and hints[k] != tried and hints[k] != near.face:
            look.covered = covers(other, hints[k], corners[0], corners[1], corners[2], limit)
            if look.covered:
                look.near = hints[k]
    if not look.covered:
        look.cut = cut_over_edge(other, near.face, corners)
        look.is_cut = look.cut.in_three
    return look


@wp.func
def look_at_piece(
    corners: Corners, start: wp.int32, other: Surface, limit: wp.float64, hints: Faces, effort: wp.int32
) -> Look:
    """Whether one face covers a piece, first ``start``, or else how to cut it."""
    look = Look()
    look.covered = wp.bool(False)
    look.is_cut = wp.bool(False)
    look.near = start
    if start >= 0:
        look.covered = covers(other, start, corners[0], corners[1], corners[2], limit)
    if not look.covered:
        centre = (corners[0] + corners[1] + corners[2]) / wp.float64(3.0)
        near = face_near(other, start, hints, centre, limit, effort)
        if near.face >= 0:
            look = look_over(corners, centre, other, near, start, hints, limit)
            if effort == SEARCH and not look.covered and not look.is_cut:
                # A walk may have ended before the nearest one.
                nearest = face_searched(other, centre, limit)
                if nearest.face >= 0 and nearest.face != near.face:
                    look = look_over(corners, centre, other, nearest, start, hints, limit)
            if not look.covered and not look.is_cut:
                look.cut = cut_in_half(corners)
                look.is_cut = wp.bool(True)
    return look


@wp.func
def write_piece(
    pieces: Pieces,
    used: wp.array[wp.int32],
    parent: wp.int32,
    owner: wp.int32,
    face: wp.int32,
    places: Places,
    other: Surface,
    corners: Corners,
) -> wp.bool:
    """Add a piece; False where there is no room."""
    room = pieces.owner.shape[0]
    # Without any room, none is wanted.
    if room == 0:
        return True
    index = wp.atomic_add(used, 0, 1)
    if index >= room:
        return False
    pieces.parent[index] = parent
    pieces.owner[index] = owner
    pieces.face[index] = face
    for k in range(3):
        there = nearest_on_face(other, face, corners[k])
        pieces.weight[index, k, 0] = wp.float32(places[k, 0])
        pieces.weight[index, k, 1] = wp.float32(places[k, 1])
        pieces.weight[index, k, 2] = wp.float32(there.weights[1])
        pieces.weight[index, k, 3] = wp.float32(there.weights[2])
    return True


@wp.func
def bound_piece(
    whole: Places,
    own: Surface,
    other: Surface,
    limit: wp.float64,
    hints_in: Faces,
    effort: wp.int32,
    parent: wp.int32,
    owner: wp.int32,
    used: wp.array[wp.int32],
    pieces_out: Pieces,
) -> Outcome:
    """Whether a piece is within the limit of a mesh; its parts are written where there is room for any.

    ``effort`` says how faces are looked for; but for SEARCH, UNDECIDED is what that does not show.
    """
    outcome = Outcome()
    outcome.verdict = WITHIN
    outcome.hints = hints_in
    a = corner_point(own, owner, 0)
    ab = corner_point(own, owner, 1) - a
    ac = corner_point(own, owner, 2) - a
    waiting = Waiting()
    start = WaitingFaces()
    for k in range(6):
        waiting[0, k] = whole[k // 2, k % 2]
    start[0] = hints_in[0]
    count = wp.int32(1)
    if effort == SEARCH:
        # What no walk leads to is mostly too far, and then mostly at a corner.
        for k in range(3):
            near = face_near(other, hints_in[0], hints_in, a + whole[k, 0] * ab + whole[k, 1] * ac, limit, effort)
            if near.face < 0:
                outcome.verdict = BEYOND
                count = 0
    looked_at = wp.int32(0)
    while count > 0:
        count -= 1
        looked_at += 1
        places = Places()
        corners = Corners()
        for k in range(3):
            places[k, 0] = waiting[count, 2 * k]
            places[k, 1] = waiting[count, 2 * k + 1]
            corners[k] = a + places[k, 0] * ab + places[k, 1] * ac
        look = look_at_piece(corners, start[count], other, limit, outcome.hints, effort)
        if look.covered:
            outcome.hints = with_face(outcome.hints, look.near)
            if not write_piece(pieces_out, used, parent, owner, look.near, places, other, corners):
                outcome.verdict = NO_ROOM
        elif not look.is_cut:
            outcome.verdict = wp.where(effort == SEARCH, BEYOND, UNDECIDED)
        elif looked_at == MAX_PIECES or count + 3 > MAX_WAITING:
            outcome.verdict = UNDECIDED
        else:
            beyond = look.near
            if look.cut.in_three:
                across = other.across[3 * look.near + look.cut.edge]
                if across >= 0:
                    beyond = across
            for part in range(wp.where(look.cut.in_three, 3, 2)):
                piece = cut_part(places, look.cut, part)
                for k in range(6):
                    waiting[count + part, k] = piece[k // 2, k % 2]
                start[count + part] = wp.where((part == 0) == look.cut.is_beyond, beyond, look.near)
            count += wp.where(look.cut.in_three, 3, 2)
        if outcome.verdict == BEYOND or outcome.verdict == UNDECIDED:
            count = 0
    return outcome


@wp.kernel
def bound_triangles(
    # in
    own: Surface,
    other: Surface,
    limit: wp.float64,
    effort: wp.int32,
    chosen: wp.array[wp.int32],
    first: wp.int32,
    # in and out
    hint: wp.array2d[wp.int32],
    used: wp.array[wp.int32],
    # out
    pieces_out: Pieces,
    verdict_out: wp.array[wp.int32],
):
    """Whether some faces of ``own``, ``chosen`` (n,), are within the limit of ``other``, see :func:`bound_piece`.

    ``hint`` (N, HINTS) are faces of ``other`` that covered pieces of it before, the last one first, -1 for none. Pieces
    are written from the ``used``-th (1,) on as long as there is room for them. The threads begin at ``first``.
    """
    i = first + wp.tid()
    face = chosen[i]
    hints = Faces()
    for k in range(HINTS):
        hints[k] = hint[face, k]
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    outcome = bound_piece(
        Places(zero, zero, one, zero, zero, one), own, other, limit, hints, effort, i, face, used, pieces_out
    )
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
    effort: wp.int32,
    pieces: Pieces,
    frame: wp.array[wp.int32],
    first: wp.int32,
    # in and out
    used: wp.array[wp.int32],
    # out
    pieces_out: Pieces,
    verdict_out: wp.array[wp.int32],
):
    """The same for pieces (n,) in the frames (n,), starting at the faces that they were within before.

    Points are (F, V) and (F, W); a search needs all frames to be that of ``other_in``.
    """
    i = first + wp.tid()
    own = own_in
    other = other_in
    own.points = own_points[frame[i]]
    other.points = other_points[frame[i]]
    owner = pieces.owner[i]
    places = Places()
    for k in range(3):
        places[k, 0] = wp.float64(pieces.weight[i, k, 0])
        places[k, 1] = wp.float64(pieces.weight[i, k, 1])
    hints = Faces()
    for k in range(HINTS):
        hints[k] = -1
    hints[0] = pieces.face[i]
    outcome = bound_piece(places, own, other, limit, hints, effort, i, owner, used, pieces_out)
    verdict_out[i] = outcome.verdict
