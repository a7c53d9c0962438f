"""Whether every point of a triangle lies within a limit of a mesh: proved, not sampled.

The distance to one triangle is convex, so over a piece of another triangle it is largest at a corner of the piece. A
piece is within the limit where one triangle of the mesh is within it at all three corners, or where its middle is
nearer by more than its corners are away (the distance to a mesh changes by no more than one moves). Other pieces are
cut where the triangle nearest to their middle ends, so that what lies over it is a piece of its own; where that does
not cut them, in half.
"""

import warp as wp

from warpqem.kernels.closest_point import closest_barycentric
from warpqem.kernels.near_faces import (
    HINTS,
    Faces,
    Surface,
    corner_point,
    covers,
    face_around,
    face_towards,
    nearest_face,
    squared_distance,
    with_first,
)
from warpqem.kernels.piece_cuts import Corners, Cut, cut_in_half, cut_over_edge

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
Waiting = wp.types.matrix(shape=(int(MAX_WAITING), 9), dtype=wp.float64)
Parts = wp.types.matrix(shape=(3, 9), dtype=wp.float64)


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
    hints: Faces


@wp.func
def face_to_try(
    other: Surface, hints: Faces, attempt: wp.int32, centre: wp.vec3d, limit: wp.float64, effort: wp.int32
) -> wp.int32:
    """The face to try, -1 for none: first those that were near before, then where a walk from the last of them ends,
    then the nearest one."""
    if attempt < HINTS:
        return hints[attempt]
    if attempt > HINTS:
        return nearest_face(other, centre, limit)
    if hints[0] >= 0:
        near = face_towards(other, hints[0], centre)
        if effort == AROUND and squared_distance(other, near, centre) > limit * limit:
            near = face_around(other, near, centre)
        return near
    return -1


@wp.func
def is_inside(corners: Corners, centre: wp.vec3d, squared: wp.float64, limit: wp.float64) -> wp.bool:
    """Whether a piece is within the limit as its middle is within a distance, given squared."""
    size = wp.max(
        wp.length_sq(corners[0] - centre), wp.max(wp.length_sq(corners[1] - centre), wp.length_sq(corners[2] - centre))
    )
    return wp.sqrt(squared) + wp.sqrt(size) <= limit


@wp.func
def look_at_piece(corners: Corners, other: Surface, limit: wp.float64, hints: Faces, effort: wp.int32) -> Look:
    """Whether one face covers a piece, or else how to cut it."""
    look = Look()
    look.covered = wp.bool(False)
    look.is_cut = wp.bool(False)
    look.hints = hints
    centre = (corners[0] + corners[1] + corners[2]) / wp.float64(3.0)
    attempt = wp.int32(0)
    last = HINTS + wp.where(effort == SEARCH, 1, 0)
    while attempt <= last and not look.covered and not look.is_cut:
        near = face_to_try(other, look.hints, attempt, centre, limit, effort)
        if near >= 0:
            look.covered = covers(other, near, corners[0], corners[1], corners[2], limit)
            if look.covered:
                look.hints = with_first(look.hints, near, wp.min(attempt, HINTS - 1))
            elif attempt >= HINTS:
                squared = squared_distance(other, near, centre)
                if squared <= limit * limit:
                    look.covered = is_inside(corners, centre, squared, limit)
                    if not look.covered:
                        look.cut = cut_over_edge(other, near, corners)
                        look.is_cut = look.cut.in_three
                        if not look.is_cut and attempt == last:
                            look.cut = cut_in_half(corners)
                            look.is_cut = True
                    look.hints = with_first(look.hints, near, HINTS - 1)
        attempt += 1
    return look


@wp.func
def cut_parts(corners: Corners, cut: Cut) -> Parts:
    """The parts of a piece, three or two, by the coordinates of their corners."""
    p = corners[cut.corner]
    q = corners[(cut.corner + 1) % 3]
    r = corners[(cut.corner + 2) % 3]
    one = p + (q - p) * cut.after
    two = p + (r - p) * cut.before
    parts = Parts()
    for k in range(3):
        parts[0, k] = p[k]
        parts[0, 3 + k] = one[k]
        parts[0, 6 + k] = two[k]
        parts[1, k] = one[k]
        parts[1, 3 + k] = q[k]
        parts[1, 6 + k] = r[k]
        parts[2, k] = one[k]
        parts[2, 3 + k] = r[k]
        parts[2, 6 + k] = two[k]
    return parts


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
def write_piece(
    pieces: Pieces,
    used: wp.array[wp.int32],
    parent: wp.int32,
    owner: wp.int32,
    face: wp.int32,
    own: Surface,
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
        write_corner(pieces, index, k, own, other, corners[k])
    return True


@wp.func
def bound_piece(
    whole: Corners,
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
    waiting = Waiting()
    for k in range(9):
        waiting[0, k] = whole[k / 3, k % 3]
    count = wp.int32(1)
    looked_at = wp.int32(0)
    while count > 0:
        count -= 1
        looked_at += 1
        corners = Corners()
        for k in range(9):
            corners[k / 3, k % 3] = waiting[count, k]
        look = look_at_piece(corners, other, limit, outcome.hints, effort)
        outcome.hints = look.hints
        if look.covered:
            if not write_piece(pieces_out, used, parent, owner, look.hints[0], own, other, corners):
                outcome.verdict = NO_ROOM
        elif not look.is_cut:
            outcome.verdict = wp.where(effort == SEARCH, BEYOND, UNDECIDED)
        elif looked_at == MAX_PIECES or count + 3 > MAX_WAITING:
            outcome.verdict = UNDECIDED
        else:
            parts = cut_parts(corners, look.cut)
            part_count = wp.where(look.cut.in_three, 3, 2)
            for part in range(part_count):
                for k in range(9):
                    waiting[count + part, k] = parts[part, k]
            count += part_count
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
    corners = Corners()
    hints = Faces()
    for k in range(3):
        corners[k] = corner_point(own, face, k)
    for k in range(HINTS):
        hints[k] = hint[face, k]
    outcome = bound_piece(corners, own, other, limit, hints, effort, i, face, used, pieces_out)
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
    a = corner_point(own, owner, 0)
    ab = corner_point(own, owner, 1) - a
    ac = corner_point(own, owner, 2) - a
    corners = Corners()
    for k in range(3):
        corners[k] = a + wp.float64(pieces.weight[i, k, 0]) * ab + wp.float64(pieces.weight[i, k, 1]) * ac
    hints = Faces()
    for k in range(HINTS):
        hints[k] = -1
    hints[0] = pieces.face[i]
    outcome = bound_piece(corners, own, other, limit, hints, effort, i, owner, used, pieces_out)
    verdict_out[i] = outcome.verdict
