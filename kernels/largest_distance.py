"""The largest distance between two surfaces in several cells at once, by branch and bound.

Cells are frames of a mesh, or meshes, as in :mod:`warpqem.kernels.surface_distance`. The distance to one face is
convex, so over a piece of a triangle it is at most the largest at the piece's corners. The search is done with a piece
where one face shows that the piece holds nothing larger than what was found, and cuts the other pieces where a face
near to their middle ends, or where another one becomes the nearer one. That face is walked to from a neighbouring
piece's; the whole mesh is searched only where a point may be beyond what was found. Pieces stay good pieces while the
mesh moves: those of the frames before, the patches, are what the search starts from in the next ones, and most of them
need none there, as :mod:`warpqem.kernels.distance_screen` shows.
"""

import warp as wp

from warpqem.kernels.near_faces import (
    ANYWHERE,
    HINTS,
    CellTable,
    Faces,
    NearFace,
    Surface,
    corner_point,
    covers,
    exactly_nearest,
    face_towards,
    nearer_face,
    of_cell,
    squared_distance,
    with_face,
    with_first,
)
from warpqem.kernels.piece_cuts import Corners, Cut, Places, cut_at_zero, cut_in_half, cut_over_edge, cut_part

# No gradients are taken. Loops stay loops: unrolled, they take several times as long to compile and run no faster.
wp.set_module_options({"enable_backward": False, "max_unroll": 1})

# What was found is within this part of the largest distance there is: a thousandth, less what single precision adds to
# the distances of samples.
TOLERANCE = wp.constant(wp.float64(0.95e-3))
# Distances of a mesh of unit diagonal that are only rounding: a few times ON_PLANE, up to which pieces reach over an
# edge.
ROUNDING = wp.constant(wp.float64(3.0e-13))
# Pieces of a patch that are looked at, and that may wait, before it is given up with what bounds it.
MAX_PIECES = wp.constant(wp.int32(4096))
MAX_WAITING = wp.constant(wp.int32(40))
# Where so many pieces of a patch were looked at, the search for near faces is the trouble: it takes, in single
# precision, the wrong one of two faces on whose edge a thin piece lies, and no cut over the wrong one's edges helps.
MANY_PIECES = wp.constant(wp.int32(256))
# Faces are as near as each other where their distances differ by less: the cut between them is through a corner.
AS_NEAR = wp.constant(wp.float64(1.0e-9))
Waiting = wp.types.matrix(shape=(int(MAX_WAITING), 6), dtype=wp.float64)
WaitingFaces = wp.types.vector(length=int(MAX_WAITING), dtype=wp.int32)
# Patches that a thread takes one after the other at most: the next one mostly lies beside the one before, over the same
# face.
RUN = wp.constant(wp.int32(16))


@wp.struct
class SearchItems:
    """Patches, each to be searched in one cell: parts of the faces of a mesh."""

    face: wp.array[wp.int32]  # (n,) counted from the first one of the cell
    place: wp.array2d[wp.float64]  # (n, 6), barycentric coordinates of corners 1 and 2 of the face, at three corners
    hint: wp.array2d[wp.int32]  # (n, HINTS), faces of the other mesh that were near before, -1 for none
    cell: wp.array[wp.int32]  # (n,)
    run: wp.array[wp.int32]  # (R+1,) where each run of patches begins that a thread takes, and the last one ends


@wp.struct
class FoundPieces:
    """What patches were cut into: no point of a piece is further from its first face than the largest distance.

    Each of P parts of the launch has an equal share of the M rows; it may find more than have room there.
    """

    count: wp.array[wp.int32]  # (P,) found by each part
    item: wp.array[wp.int32]  # (M,)
    place: wp.array2d[wp.float64]  # (M, 6)
    hint: wp.array2d[wp.int32]  # (M, HINTS)


@wp.struct
class Found:
    """What the search of a patch comes to: no point of it is further than the larger of both distances."""

    low: wp.float64  # a point is at it, where it is above the floor
    high: wp.float64
    hints: Faces  # faces that were near last


@wp.struct
class Look:
    """What a look at a piece finds."""

    near: wp.int32  # a face near to its middle, the nearest one where that is beyond what was found; -1 for none
    away: wp.vec3d  # the distances of its corners from that face: no point of the piece is further
    rival: wp.int32  # a face nearer to the corner that is furthest from the other one, or that one
    low: wp.float64  # the largest distance found so far, there and before


@wp.struct
class Division:
    """How a piece is cut, and which face is near beyond the cut."""

    cut: Cut
    beyond: wp.int32


@wp.func
def place_corners(surface: Surface, face: wp.int32, places: Places) -> Corners:
    """The corners of a piece of a face."""
    a = corner_point(surface, face, 0)
    ab = corner_point(surface, face, 1) - a
    ac = corner_point(surface, face, 2) - a
    corners = Corners()
    for k in range(3):
        corners[k] = a + places[k, 0] * ab + places[k, 1] * ac
    return corners


@wp.func
def corner_distances(other: Surface, face: wp.int32, corners: Corners) -> wp.vec3d:
    """The distances of the corners of a piece from a face: no point of the piece is further than the largest."""
    away = wp.vec3d()
    for k in range(3):
        away[k] = wp.sqrt(squared_distance(other, face, corners[k]))
    return away


@wp.func
def divide_piece(other: Surface, look: Look, corners: Corners) -> Division:
    """The cut where the rival of the near face becomes the nearer one; without, at the plane over that edge of the near
    face beyond which the piece reaches furthest; else in half.
    """
    division = Division()
    division.beyond = look.near
    division.cut.in_three = wp.bool(False)
    if look.rival != look.near:
        side = look.away - corner_distances(other, look.rival, corners)
        if wp.max(side) > AS_NEAR and wp.min(side) < -AS_NEAR:
            division.cut = cut_at_zero(side)
            division.beyond = look.rival
            return division
    division.cut = cut_over_edge(other, look.near, corners)
    if division.cut.in_three:
        across = other.across[3 * look.near + division.cut.edge]
        if across >= 0:
            division.beyond = across
        return division
    division.cut = cut_in_half(corners)
    return division


@wp.func
def covering_hint(other: Surface, hints: Faces, first: wp.int32, corners: Corners, limit: wp.float64) -> wp.int32:
    """The first of the hints that is within the limit of all points of a piece, or -1."""
    found = wp.int32(-1)
    for k in range(HINTS):
        if hints[k] >= 0 and found < 0:  # noqa: SIM102 - a kernel evaluates both sides of an "and"
            if covers(other, first + hints[k], corners[0], corners[1], corners[2], limit):
                found = k
    return found


@wp.func
def upper_limit(low: wp.float64) -> wp.float64:
    """What may be left open above the largest distance found."""
    return low * (wp.float64(1.0) + TOLERANCE) + ROUNDING


@wp.func
def face_from(other: Surface, start: wp.int32, p: wp.vec3d, low: wp.float64, exact: wp.bool) -> NearFace:
    """A face near to a point by a walk from one, -1 for none: the nearest one where that is further than ``low``.

    Also where it is to be ``exact``, it is the nearest one in double precision. -1 where the search finds none.
    """
    found = NearFace()
    found.face = start
    found.squared = ANYWHERE * ANYWHERE
    if start >= 0:
        found = face_towards(other, start, p)
        found.squared = squared_distance(other, found.face, p)
    if exact or found.squared > low * low:
        found.face = nearer_face(other, found.face, found.squared, p)
        if found.face >= 0:
            found.squared = squared_distance(other, found.face, p)
            if exact or found.squared > low * low:
                found.face = exactly_nearest(other, found.face, found.squared, p)
                found.squared = squared_distance(other, found.face, p)
    return found


@wp.func
def look_at_piece(other: Surface, start: wp.int32, corners: Corners, low: wp.float64, exact: wp.bool) -> Look:
    """A face near to the middle of a piece, and what it says; ``low`` is the largest distance found before."""
    look = Look()
    look.low = low
    centre = (corners[0] + corners[1] + corners[2]) / wp.float64(3.0)
    near = face_from(other, start, centre, low, exact)
    look.near = near.face
    look.rival = near.face
    if near.face >= 0:
        look.low = wp.max(low, wp.sqrt(near.squared))
        size = wp.float64(0.0)
        for k in range(3):
            size = wp.max(size, wp.length(corners[k] - centre))
        look.away = corner_distances(other, near.face, corners)
        bound = wp.max(look.away)
        if bound > look.low + ROUNDING and bound <= upper_limit(look.low):
            # Within the tolerance, as far as this face says; the nearest one may say that it is no more than was found.
            near = face_from(other, near.face, centre, look.low, wp.bool(True))
            look.near = near.face
            look.rival = near.face
            look.away = corner_distances(other, near.face, corners)
        if wp.max(look.away) > look.low + ROUNDING and size <= look.low:
            # What is furthest is most often a corner. Those of large pieces are corners of small ones.
            furthest = wp.float64(0.0)
            for k in range(3):
                # No other face makes it further away than this one.
                if look.away[k] > look.low:
                    at_corner = face_from(other, near.face, corners[k], look.low, exact)
                    if at_corner.face >= 0:
                        look.low = wp.max(look.low, wp.sqrt(at_corner.squared))
                        if look.away[k] > furthest:
                            furthest = look.away[k]
                            look.rival = at_corner.face
    return look


@wp.func
def keep_piece(pieces: FoundPieces, part: wp.int32, item: wp.int32, places: Places, hints: Faces):
    """Count a piece that the search is done with, and write it down where there is room."""
    room = pieces.item.shape[0] / pieces.count.shape[0]
    if room == 0:
        return
    place = wp.atomic_add(pieces.count, part, 1)
    if place < room:
        row = part * room + place
        pieces.item[row] = item
        for k in range(3):
            pieces.place[row, 2 * k] = places[k, 0]
            pieces.place[row, 2 * k + 1] = places[k, 1]
        for k in range(HINTS):
            pieces.hint[row, k] = hints[k]


@wp.func
def search_patch(
    own: Surface,
    other: Surface,
    face: wp.int32,
    first: wp.int32,
    items: SearchItems,
    item: wp.int32,
    low: wp.float64,
    hints: Faces,
    part: wp.int32,
    pieces: FoundPieces,
) -> Found:
    """Branch and bound over one patch, of the face ``face`` of ``own``.

    ``first`` is the first face of the same cell of ``other``, ``low`` the distance that is of no interest, and
    ``hints`` are faces that may be near.
    """
    found = Found()
    found.low = low
    found.hints = hints
    waiting = Waiting()
    start = WaitingFaces()
    for k in range(6):
        waiting[0, k] = items.place[item, k]
    start[0] = wp.int32(-1)
    count = wp.int32(1)
    looked_at = wp.int32(0)
    while count > 0:
        count -= 1
        places = Places(
            waiting[count, 0],
            waiting[count, 1],
            waiting[count, 2],
            waiting[count, 3],
            waiting[count, 4],
            waiting[count, 5],
        )
        corners = place_corners(own, face, places)
        limit = found.low + ROUNDING
        done = wp.bool(False)
        if start[count] >= 0:
            done = covers(other, start[count], corners[0], corners[1], corners[2], limit)
            if done:
                found.hints = with_face(found.hints, start[count] - first)
        else:
            hint = covering_hint(other, found.hints, first, corners, limit)
            done = hint >= 0
            if done:
                found.hints = with_first(found.hints, found.hints[hint], hint)
        if not done:
            begin = start[count]
            if begin < 0 and found.hints[0] >= 0:
                # The piece before lies beside it.
                begin = first + found.hints[0]
            look = look_at_piece(other, begin, corners, found.low, looked_at >= MANY_PIECES)
            found.low = look.low
            looked_at += 1
            bound = wp.max(look.away)
            if look.near < 0:
                done = wp.bool(True)
            elif bound <= upper_limit(found.low) or looked_at >= MAX_PIECES or count + 3 > MAX_WAITING:
                done = wp.bool(True)
                found.hints = with_first(found.hints, look.near - first, HINTS - 1)
                if bound > found.low + ROUNDING:
                    found.high = wp.max(found.high, bound)
            else:
                division = divide_piece(other, look, corners)
                cut = division.cut
                for index in range(3):
                    piece = cut_part(places, cut, index)
                    for k in range(6):
                        waiting[count + index, k] = piece[k // 2, k % 2]
                    start[count + index] = wp.where((index == 0) == cut.is_beyond, division.beyond, look.near)
                # In half, there is no third.
                count += wp.where(cut.in_three, 3, 2)
        if done:
            keep_piece(pieces, part, item, places, found.hints)
    return found


@wp.kernel
def largest_distances(
    # in
    own: Surface,
    others: Surface,
    own_cells: CellTable,
    other_cells: CellTable,
    floor: wp.array[wp.float64],
    items: SearchItems,
    part: wp.int32,
    first_run: wp.int32,
    # in and out
    pieces: FoundPieces,
    # out
    low_out: wp.array[wp.float64],
    high_out: wp.array[wp.float64],
    hint_out: wp.array2d[wp.int32],
):
    """The largest distance of each patch of ``own`` from ``others``, where that is beyond the floor (C,) of its cell.

    No point of the patch is further than the larger of ``low`` and ``high``, and one is at ``low``, if that is above
    the floor. ``high`` is above ``low`` by no more than the tolerance, but where a patch was given up. The pieces that
    the patches were cut into are kept in the order they are found. ``hint_out`` are faces that were near last.
    """
    run = first_run + wp.tid()
    hints = Faces()
    for k in range(HINTS):
        hints[k] = wp.int32(-1)
    for item in range(items.run[run], items.run[run + 1]):
        if items.hint[item, 0] >= 0:
            for k in range(HINTS):
                hints[k] = items.hint[item, k]
        cell = items.cell[item]
        face = own_cells.first_face[cell] + items.face[item]
        first = other_cells.first_face[cell]
        other = of_cell(others, other_cells, cell)
        found = search_patch(own, other, face, first, items, item, floor[cell], hints, part, pieces)
        hints = found.hints
        low_out[item] = found.low
        high_out[item] = found.high
        for k in range(HINTS):
            hint_out[item, k] = hints[k]
