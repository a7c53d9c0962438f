"""Distances between two surfaces in several frames at once: at samples, and the largest one by branch and bound.

The frames of a mesh are cells of one mesh, so far apart that the nearest face of a point is one of its own cell.

The distance to one face is convex, so over a piece of a triangle it is at most the largest at the piece's corners. The
search for the largest distance is done with a piece where one face shows that the piece holds nothing larger than what
was found, and cuts the other pieces where the face nearest to their middle ends. Pieces stay good pieces while the mesh
moves: those of the frames before, the patches, are what the search starts from in the next ones, and most of them need
none there, as :mod:`warpqem.kernels.distance_screen` shows.
"""

import warp as wp

from warpqem.kernels.near_faces import (
    HINTS,
    SEARCH_MARGIN,
    Faces,
    Surface,
    corner_point,
    covers,
    squared_distance,
    with_first,
)
from warpqem.kernels.piece_cuts import Corners, Cut, cut_in_half, cut_over_edge

# No gradients are taken. Loops stay loops: unrolled, they take several times as long to compile and run no faster.
wp.set_module_options({"enable_backward": False, "max_unroll": 1})

# What was found is within this part of the largest distance there is.
TOLERANCE = wp.constant(wp.float64(1.0e-3))
# Distances of a mesh of unit diagonal that are only rounding.
ROUNDING = wp.constant(wp.float64(5.0e-15))
# The search is in single precision, which may pick the other one of two faces that are as near to 2e-7. Below this
# distance that is more than a fifth of a percent of it, and the choice is made again in double precision.
EXACT_BELOW = wp.constant(wp.float64(1.0e-4))
# A search of this radius finds whatever there is; its square fits single precision.
SEARCH_RADIUS = wp.constant(1.0e15)
# Beyond every distance; its square fits single precision.
ANYWHERE = wp.constant(wp.float64(1.0e15))
# Pieces of a patch that are looked at, and that may wait, before it is given up with what bounds it.
MAX_PIECES = wp.constant(wp.int32(4096))
MAX_WAITING = wp.constant(wp.int32(40))
Places = wp.types.matrix(shape=(3, 2), dtype=wp.float64)  # of three corners, as MeshPatches.place
Waiting = wp.types.matrix(shape=(int(MAX_WAITING), 6), dtype=wp.float64)
# Two faces whose normals have a cosine below this are the two sides of one spot.
OPPOSITE = wp.constant(wp.float64(-0.99))
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
    """What patches were cut into: no point of a piece is further from its first face than the largest distance."""

    item: wp.array[wp.int32]  # (M,)
    place: wp.array2d[wp.float64]  # (M, 6)
    hint: wp.array2d[wp.int32]  # (M, HINTS)


@wp.func
def face_normal(surface: Surface, face: wp.int32) -> wp.vec3d:
    """The cross product of two edges of a face: its normal, as long as twice its area."""
    a = corner_point(surface, face, 0)
    return wp.cross(corner_point(surface, face, 1) - a, corner_point(surface, face, 2) - a)


@wp.kernel
def face_areas(
    # in
    surface: Surface,
    # out
    area_out: wp.array[wp.float64],
):
    """Area of each face."""
    face = wp.tid()
    area_out[face] = wp.float64(0.5) * wp.length(face_normal(surface, face))


@wp.func
def exactly_nearest(other: Surface, near: wp.int32, squared: wp.float64, p: wp.vec3d) -> wp.int32:
    """The face nearest to a point in double precision, the first of equal ones; one is known at a squared distance."""
    best = near
    best_squared = squared
    centre = wp.vec3(wp.float32(p[0]), wp.float32(p[1]), wp.float32(p[2]))
    reach = wp.float32(wp.sqrt(squared) + SEARCH_MARGIN)
    extent = wp.vec3(reach, reach, reach)
    query = wp.mesh_query_aabb(other.mesh, centre - extent, centre + extent)
    face = wp.int32(0)
    while wp.mesh_query_next(query, face):
        found = squared_distance(other, face, p)
        if found < best_squared or (found == best_squared and face < best):
            best = face
            best_squared = found
    return best


@wp.func
def side_facing(other: Surface, near: wp.int32, squared: wp.float64, p: wp.vec3d, normal: wp.vec3d) -> wp.int32:
    """The face nearest to a point, or a face of the same spot that does not oppose a normal, if there is one.

    Where a surface has two sides on the same points, or faces twice, the nearest face is any of them. ``near`` is the
    nearest one at a squared distance. Of the same spot are faces as near that are the other side of it; where the point
    lies on the surface, all that are as near; and a nearer one, which the search left out as a sliver.
    """
    found = near
    normal_near = face_normal(other, near)
    if wp.dot(normal, normal_near) < wp.float64(0.0):
        distance = wp.sqrt(squared)
        centre = wp.vec3(wp.float32(p[0]), wp.float32(p[1]), wp.float32(p[2]))
        reach = wp.float32(distance + SEARCH_MARGIN)
        extent = wp.vec3(reach, reach, reach)
        query = wp.mesh_query_aabb(other.mesh, centre - extent, centre + extent)
        face = wp.int32(0)
        while wp.mesh_query_next(query, face):
            normal_there = face_normal(other, face)
            if found == near and wp.dot(normal, normal_there) > wp.float64(0.0):
                away = wp.sqrt(squared_distance(other, face, p)) - distance
                lengths = wp.length(normal_near) * wp.length(normal_there)
                same_spot = distance <= SEARCH_MARGIN or wp.dot(normal_near, normal_there) < OPPOSITE * lengths
                if away < -SEARCH_MARGIN or (away <= SEARCH_MARGIN and same_spot):
                    found = face
    return found


@wp.kernel
def sample_distances(
    # in
    own: Surface,
    other: Surface,
    sample_face: wp.array[wp.int32],
    sample_place: wp.array[wp.vec2d],
    first_sample: wp.int32,
    # out
    distance_out: wp.array[wp.float64],
    angle_out: wp.array[wp.float64],
    near_out: wp.array[wp.int32],
):
    """Distance of samples from the other surface, and the angle between the normals of both faces, in degrees.

    ``sample_place`` (S,) are the barycentric coordinates of the second and third corner. Of a surface with two sides on
    the same points, the one that faces the sample's way counts. A distance is -1 where the search finds no face, as all
    of them are slivers.
    """
    i = first_sample + wp.tid()
    face = sample_face[i]
    place = sample_place[i]
    a = corner_point(own, face, 0)
    b = corner_point(own, face, 1)
    c = corner_point(own, face, 2)
    p = a + place[0] * (b - a) + place[1] * (c - a)
    found = wp.mesh_query_point_no_sign(
        other.mesh, wp.vec3(wp.float32(p[0]), wp.float32(p[1]), wp.float32(p[2])), SEARCH_RADIUS
    )
    near_out[i] = wp.int32(-1)
    distance_out[i] = wp.float64(-1.0)
    angle_out[i] = wp.float64(0.0)
    if found.result:
        nearest = found.face
        squared = squared_distance(other, nearest, p)
        if squared < EXACT_BELOW * EXACT_BELOW:
            nearest = exactly_nearest(other, nearest, squared, p)
            squared = squared_distance(other, nearest, p)
        distance_out[i] = wp.sqrt(squared)
        normal = face_normal(own, face)
        near = side_facing(other, nearest, squared, p, normal)
        near_out[i] = near
        # A face without area has no normal, which counts as a right angle.
        cosine = wp.dot(wp.normalize(normal), wp.normalize(face_normal(other, near)))
        angle_out[i] = wp.degrees(wp.acos(wp.clamp(cosine, wp.float64(-1.0), wp.float64(1.0))))


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
        if squared_distance(other, found.face, p) < best_squared:
            nearest = found.face
    return nearest


@wp.func
def near_face(other: Surface, hints: Faces, first: wp.int32, p: wp.vec3d) -> wp.int32:
    """The face nearest to a point; ``hints`` bound the search. -1 where there are neither hints nor faces."""
    best = wp.int32(-1)
    best_squared = ANYWHERE * ANYWHERE
    for k in range(HINTS):
        if hints[k] >= 0:
            squared = squared_distance(other, first + hints[k], p)
            if squared < best_squared:
                best = first + hints[k]
                best_squared = squared
    return nearer_face(other, best, best_squared, p)


@wp.kernel
def find_flips(
    # in
    own: Surface,
    other: Surface,
    own_count: wp.int32,
    other_count: wp.int32,
    frame_count: wp.int32,
    smallest: wp.float64,
    # in and out
    nearest: wp.array[wp.int32],
    # in
    first_face: wp.int32,
    # out
    opposed_out: wp.array2d[wp.int32],
):
    """The face that each face with more than the smallest area opposes, where it does: the one nearest to its middle.

    -1 for the others. Of a surface with two sides on the same points, a face opposes neither. ``nearest`` (N,) is the
    nearest face when it was last looked for, -1 for none; it bounds the search.
    """
    face = first_face + wp.tid()
    near = nearest[face]
    for frame in range(frame_count):
        cell_face = frame * own_count + face
        first = frame * other_count
        opposed_out[frame, face] = wp.int32(-1)
        normal = face_normal(own, cell_face)
        if wp.float64(0.5) * wp.length(normal) > smallest:
            corners = Corners()
            for k in range(3):
                corners[k] = corner_point(own, cell_face, k)
            middle = (corners[0] + corners[1] + corners[2]) / wp.float64(3.0)
            known = wp.int32(-1)
            squared = ANYWHERE * ANYWHERE
            if near >= 0:
                known = first + near
                squared = squared_distance(other, known, middle)
            found = nearer_face(other, known, squared, middle)
            if found >= 0:
                near = found - first
                side = side_facing(other, found, squared_distance(other, found, middle), middle, normal)
                if wp.dot(normal, face_normal(other, side)) < wp.float64(0.0):
                    opposed_out[frame, face] = side - first
    nearest[face] = near


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
def furthest_corner(other: Surface, face: wp.int32, corners: Corners) -> wp.float64:
    """The largest distance of the corners of a piece from a face, which no point of the piece is further from."""
    furthest = wp.float64(0.0)
    for k in range(3):
        furthest = wp.max(furthest, squared_distance(other, face, corners[k]))
    return wp.sqrt(furthest)


@wp.func
def cut_piece(other: Surface, face: wp.int32, corners: Corners) -> Cut:
    """The cut at the plane over that edge of a face beyond which the piece reaches furthest; else in half."""
    cut = cut_over_edge(other, face, corners)
    if not cut.in_three:
        cut = cut_in_half(corners)
    return cut


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
    piece_count: wp.array[wp.int32],
    # out
    piece: FoundPieces,
    low_out: wp.array[wp.float64],
    high_out: wp.array[wp.float64],
    hint_out: wp.array2d[wp.int32],
):
    """The largest distance of each patch of ``own`` from ``other``, where that is beyond the floor (F,) of its frame.

    No point of the patch is further than the larger of ``low`` and ``high``, and one is at ``low``, if that is above
    the floor. ``high`` is above ``low`` by no more than the tolerance, but where a patch was given up. The pieces that
    the patches were cut into are counted in ``piece_count`` of this part, and kept as far as ``piece`` has room for the
    part: (parts, room), in the order they are found. ``hint_out`` are faces that were near last.
    """
    run = first_run + wp.tid()
    item_count = items.face.shape[0]
    room = piece.item.shape[0] / piece_count.shape[0]
    hints = Faces()
    for k in range(HINTS):
        hints[k] = wp.int32(-1)
    waiting = Waiting()
    for item in range(run * RUN, wp.min((run + 1) * RUN, item_count)):
        if items.hint[item, 0] >= 0:
            for k in range(HINTS):
                hints[k] = items.hint[item, k]
        frame = items.frame[item]
        face = frame * own_count + items.face[item]
        first = frame * other_count
        low = floor[frame]
        high = wp.float64(0.0)
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
            done = wp.bool(False)
            for k in range(HINTS):
                if hints[k] >= 0 and not done:
                    done = covers(other, first + hints[k], corners[0], corners[1], corners[2], low + ROUNDING)
                    if done:
                        hints = with_first(hints, hints[k], k)
            if not done:
                centre = (corners[0] + corners[1] + corners[2]) / wp.float64(3.0)
                near = near_face(other, hints, first, centre)
                if near < 0:
                    done = wp.bool(True)
                else:
                    distance = wp.sqrt(squared_distance(other, near, centre))
                    low = wp.max(low, distance)
                    size = wp.float64(0.0)
                    for k in range(3):
                        size = wp.max(size, wp.length(corners[k] - centre))
                    bound = furthest_corner(other, near, corners)
                    if bound > low + ROUNDING and size <= low:
                        # What is furthest is most often a corner. Those of large pieces are corners of small ones.
                        for k in range(3):
                            at_corner = near_face(other, hints, first, corners[k])
                            if at_corner >= 0:
                                low = wp.max(low, wp.sqrt(squared_distance(other, at_corner, corners[k])))
                    looked_at += 1
                    if bound <= low * (wp.float64(1.0) + TOLERANCE) + ROUNDING:
                        done = wp.bool(True)
                        hints = with_first(hints, near - first, HINTS - 1)
                        if bound > low + ROUNDING:
                            high = wp.max(high, bound)
                    elif looked_at >= MAX_PIECES or count + 3 > MAX_WAITING:
                        done = wp.bool(True)
                        hints = with_first(hints, near - first, HINTS - 1)
                        high = wp.max(high, bound)
                    else:
                        cut = cut_piece(other, near, corners)
                        p = places[cut.corner]
                        q = places[(cut.corner + 1) % 3]
                        r = places[(cut.corner + 2) % 3]
                        one = p + cut.after * (q - p)
                        two = p + cut.before * (r - p)
                        for axis in range(2):
                            waiting[count, axis] = p[axis]
                            waiting[count, 2 + axis] = one[axis]
                            waiting[count, 4 + axis] = two[axis]
                            waiting[count + 1, axis] = one[axis]
                            waiting[count + 1, 2 + axis] = q[axis]
                            waiting[count + 1, 4 + axis] = r[axis]
                            waiting[count + 2, axis] = one[axis]
                            waiting[count + 2, 2 + axis] = r[axis]
                            waiting[count + 2, 4 + axis] = two[axis]
                        # In half, there is no third.
                        count += wp.where(cut.in_three, 3, 2)
            if done and room > 0:
                place = wp.atomic_add(piece_count, part, 1)
                if place < room:
                    row = part * room + place
                    piece.item[row] = item
                    for k in range(3):
                        piece.place[row, 2 * k] = places[k, 0]
                        piece.place[row, 2 * k + 1] = places[k, 1]
                    for k in range(HINTS):
                        piece.hint[row, k] = hints[k]
        low_out[item] = low
        high_out[item] = high
        for k in range(HINTS):
            hint_out[item, k] = hints[k]
