"""The largest distance between two surfaces in several frames at once, by branch and bound.

Frames are cells of one mesh, as in :mod:`warpqem.kernels.surface_distance`. The distance to one face is convex, so over
a piece of a triangle it is at most the largest at the piece's corners. The search is done with a piece where one face
shows that the piece holds nothing larger than what was found, and cuts the other pieces where the face nearest to their
middle ends. Pieces stay good pieces while the mesh moves: those of the frames before, the patches, are what the search
starts from in the next ones, and most of them need none there, as :mod:`warpqem.kernels.distance_screen` shows.
"""

import warp as wp

from warpqem.kernels.near_faces import (
    ANYWHERE,
    HINTS,
    Faces,
    Surface,
    corner_point,
    covers,
    exactly_nearest,
    nearer_face,
    squared_distance,
    with_first,
)
from warpqem.kernels.piece_cuts import Corners, Cut, Places, cut_in_half, cut_over_edge, cut_part

# No gradients are taken. Loops stay loops: unrolled, they take several times as long to compile and run no faster.
wp.set_module_options({"enable_backward": False, "max_unroll": 1})

# What was found is within this part of the largest distance there is.
TOLERANCE = wp.constant(wp.float64(1.0e-3))
# Distances of a mesh of unit diagonal that are only rounding: a few times ON_PLANE, up to which pieces reach over an
# edge.
ROUNDING = wp.constant(wp.float64(3.0e-13))
# Pieces of a patch that are looked at, and that may wait, before it is given up with what bounds it.
MAX_PIECES = wp.constant(wp.int32(4096))
MAX_WAITING = wp.constant(wp.int32(40))
# Where so many pieces of a patch were looked at, the search for near faces is the trouble: it takes, in single
# precision, the wrong one of two faces on whose edge a thin piece lies, and no cut over the wrong one's edges helps.
MANY_PIECES = wp.constant(wp.int32(8))
Waiting = wp.types.matrix(shape=(int(MAX_WAITING), 6), dtype=wp.float64)
# Patches that a thread takes one after the other: the next one mostly lies beside the one before, over the same face.
RUN = wp.constant(wp.int32(16))


@wp.struct
class SearchItems:
    """Patches, each to be searched in one frame: parts of the faces of a mesh."""

    face: wp.array[wp.int32]  # (n,)
    place: wp.array2d[wp.float64]  # (n, 6), barycentric coordinates of corners 1 and 2 of the face, at three corners
    hint: wp.array2d[wp.int32]  # (n, HINTS), faces of the other mesh that were near before, -1 for none
    frame: wp.array[wp.int32]  # (n,)


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

    near: wp.int32  # the face nearest to its middle, -1 where there is none
    low: wp.float64  # the largest distance found so far, there and before
    bound: wp.float64  # no point of the piece is further than that


@wp.func
def near_face(other: Surface, hints: Faces, first: wp.int32, p: wp.vec3d, exact: wp.bool) -> wp.int32:
    """The face nearest to a point; ``hints`` bound the search. -1 where there are neither hints nor faces.

    Of faces that single precision does not tell apart it is any, unless it is to be ``exact``.
    """
    best = wp.int32(-1)
    best_squared = ANYWHERE * ANYWHERE
    for k in range(HINTS):
        if hints[k] >= 0:
            squared = squared_distance(other, first + hints[k], p)
            if squared < best_squared:
                best = first + hints[k]
                best_squared = squared
    best = nearer_face(other, best, best_squared, p)
    if exact and best >= 0:
        best = exactly_nearest(other, best, squared_distance(other, best, p), p)
    return best


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
def cut_piece(other: Surface, face: wp.int32, corners: Corners) -> Cut:
    """The cut at the plane over that edge of a face beyond which the piece reaches furthest; else in half."""
    cut = cut_over_edge(other, face, corners)
    if not cut.in_three:
        cut = cut_in_half(corners)
    return cut


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
def look_at_piece(
    other: Surface, hints: Faces, first: wp.int32, corners: Corners, low: wp.float64, exact: wp.bool
) -> Look:
    """The face nearest to the middle of a piece, and what it says; ``low`` is the largest distance found before."""
    look = Look()
    look.low = low
    centre = (corners[0] + corners[1] + corners[2]) / wp.float64(3.0)
    look.near = near_face(other, hints, first, centre, exact)
    if look.near >= 0:
        look.low = wp.max(low, wp.sqrt(squared_distance(other, look.near, centre)))
        size = wp.float64(0.0)
        for k in range(3):
            size = wp.max(size, wp.length(corners[k] - centre))
        away = corner_distances(other, look.near, corners)
        look.bound = wp.max(away)
        if look.bound > look.low + ROUNDING and size <= look.low:
            # What is furthest is most often a corner. Those of large pieces are corners of small ones.
            for k in range(3):
                # No other face makes it further away than this one.
                if away[k] > look.low:
                    at_corner = near_face(other, hints, first, corners[k], exact)
                    if at_corner >= 0:
                        look.low = wp.max(look.low, wp.sqrt(squared_distance(other, at_corner, corners[k])))
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
    for k in range(6):
        waiting[0, k] = items.place[item, k]
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
        hint = covering_hint(other, found.hints, first, corners, found.low + ROUNDING)
        done = hint >= 0
        if done:
            found.hints = with_first(found.hints, found.hints[hint], hint)
        else:
            look = look_at_piece(other, found.hints, first, corners, found.low, looked_at >= MANY_PIECES)
            found.low = look.low
            looked_at += 1
            if look.near < 0:
                done = wp.bool(True)
            elif look.bound <= found.low * (wp.float64(1.0) + TOLERANCE) + ROUNDING or (
                looked_at >= MAX_PIECES or count + 3 > MAX_WAITING
            ):
                done = wp.bool(True)
                found.hints = with_first(found.hints, look.near - first, HINTS - 1)
                if look.bound > found.low + ROUNDING:
                    found.high = wp.max(found.high, look.bound)
            else:
                cut = cut_piece(other, look.near, corners)
                for index in range(3):
                    piece = cut_part(places, cut, index)
                    for k in range(6):
                        waiting[count + index, k] = piece[k // 2, k % 2]
                # In half, there is no third.
                count += wp.where(cut.in_three, 3, 2)
        if done:
            keep_piece(pieces, part, item, places, found.hints)
    return found


@wp.kernel
def largest_distances(
    # in
    own: Surface,
    other: Surface,
    own_count: wp.int32,
    other_count: wp.int32,
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
    """The largest distance of each patch of ``own`` from ``other``, where that is beyond the floor (F,) of its frame.

    No point of the patch is further than the larger of ``low`` and ``high``, and one is at ``low``, if that is above
    the floor. ``high`` is above ``low`` by no more than the tolerance, but where a patch was given up. The pieces that
    the patches were cut into are kept in the order they are found. ``hint_out`` are faces that were near last.
    """
    run = first_run + wp.tid()
    item_count = items.face.shape[0]
    hints = Faces()
    for k in range(HINTS):
        hints[k] = wp.int32(-1)
    for item in range(run * RUN, wp.min((run + 1) * RUN, item_count)):
        if items.hint[item, 0] >= 0:
            for k in range(HINTS):
                hints[k] = items.hint[item, k]
        frame = items.frame[item]
        face = frame * own_count + items.face[item]
        found = search_patch(own, other, face, frame * other_count, items, item, floor[frame], hints, part, pieces)
        hints = found.hints
        low_out[item] = found.low
        high_out[item] = found.high
        for k in range(HINTS):
            hint_out[item, k] = hints[k]
