"""Distances between two surfaces in several frames at once: at samples, and the largest one by branch and bound.

The frames of a mesh are cells of one mesh, so far apart that the nearest face of a point is one of its own cell.

The distance to one face is convex, so over a piece of a triangle it is at most the largest at the piece's corners. The
search for the largest distance is done with a piece where one face shows that the piece holds nothing larger than what
was found, and cuts the other pieces where the face nearest to their middle ends. Pieces stay good pieces while the mesh
moves: those of the first frame, the patches, are what the search starts from in the others, each with the faces that
were enough before. So most of them take one look at one face.
"""

import warp as wp

from warpqem.kernels.closest_point import closest_on_mesh
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
# Beyond every distance; its square fits single precision.
ANYWHERE = wp.constant(wp.float64(1.0e15))
# Pieces of a patch that are looked at, and that may wait, before it is given up with what bounds it.
MAX_PIECES = wp.constant(wp.int32(4096))
MAX_WAITING = wp.constant(wp.int32(40))
Places = wp.types.matrix(shape=(3, 2), dtype=wp.float64)  # of three corners, as MeshPatches.place
Waiting = wp.types.matrix(shape=(int(MAX_WAITING), 6), dtype=wp.float64)
Parts = wp.types.matrix(shape=(3, 6), dtype=wp.float64)
# Patches that a thread takes one after the other: the next one mostly lies beside the one before, over the same face.
RUN = wp.constant(wp.int32(16))


@wp.struct
class MeshPatches:
    """Parts of the faces of a mesh that together are the whole of it, in all frames."""

    face: wp.array[wp.int32]  # (P,)
    place: wp.array2d[wp.float64]  # (P, 6), barycentric coordinates of corners 1 and 2 of the face, at three corners
    hint: wp.array2d[wp.int32]  # (P, HINTS), faces of the other mesh that were near before, -1 for none


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
):
    """Distance of samples from the other surface, and the angle between the normals of both faces, in degrees.

    ``sample_place`` (S,) are the barycentric coordinates of the second and third corner. A distance is -1 where the
    search finds no face, as all of them are slivers.
    """
    i = first_sample + wp.tid()
    face = sample_face[i]
    place = sample_place[i]
    a = corner_point(own, face, 0)
    b = corner_point(own, face, 1)
    c = corner_point(own, face, 2)
    hit = closest_on_mesh(other.mesh, other.points, other.corner_vertex, a + place[0] * (b - a) + place[1] * (c - a))
    distance_out[i] = wp.float64(-1.0)
    angle_out[i] = wp.float64(0.0)
    if hit.face >= 0:
        distance_out[i] = wp.sqrt(hit.squared)
        # A face without area has no normal, which counts as a right angle.
        cosine = wp.dot(wp.normalize(face_normal(own, face)), wp.normalize(face_normal(other, hit.face)))
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
    flipped_out: wp.array2d[wp.int32],
):
    """1 for each face with more than the smallest area whose normal opposes that of the face nearest to its middle.

    ``nearest`` (N,) is that face when it was last looked for, -1 for none; it bounds the search.
    """
    face = first_face + wp.tid()
    near = nearest[face]
    for frame in range(frame_count):
        cell_face = frame * own_count + face
        first = frame * other_count
        flipped_out[frame, face] = 0
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
                if wp.dot(normal, face_normal(other, found)) < wp.float64(0.0):
                    flipped_out[frame, face] = 1
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
def covering_hint(other: Surface, hints: Faces, first: wp.int32, corners: Corners, limit: wp.float64) -> wp.int32:
    """The first one of the hints whose face covers a piece, -1 for none."""
    found = wp.int32(-1)
    for k in range(HINTS):
        if hints[k] >= 0 and found < 0:  # noqa: SIM102 - a kernel evaluates both sides of an "and"
            if covers(other, first + hints[k], corners[0], corners[1], corners[2], limit):
                found = k
    return found


@wp.struct
class Look:
    """What was found of a piece: a face near to its middle, -1 for none; a distance, and what bounds all of them."""

    near: wp.int32
    low: wp.float64
    bound: wp.float64


@wp.func
def look_at_piece(other: Surface, hints: Faces, first: wp.int32, corners: Corners, low: wp.float64) -> Look:
    """Distances of a piece, where one of ``low`` is known."""
    look = Look()
    look.low = low
    centre = (corners[0] + corners[1] + corners[2]) / wp.float64(3.0)
    look.near = near_face(other, hints, first, centre)
    if look.near >= 0:
        distance = wp.sqrt(squared_distance(other, look.near, centre))
        look.low = wp.max(low, distance)
        size = wp.float64(0.0)
        for k in range(3):
            size = wp.max(size, wp.length(corners[k] - centre))
        look.bound = wp.min(distance + size, furthest_corner(other, look.near, corners))
        if look.bound > look.low + ROUNDING and size <= look.low:
            # What is furthest is most often a corner. Those of large pieces are corners of small ones.
            for k in range(3):
                at_corner = near_face(other, hints, first, corners[k])
                if at_corner >= 0:
                    look.low = wp.max(look.low, wp.sqrt(squared_distance(other, at_corner, corners[k])))
    return look


@wp.func
def cut_at(other: Surface, face: wp.int32, corners: Corners) -> Cut:
    """The cut of a piece over an edge of a face, or in half."""
    cut = cut_over_edge(other, face, corners)
    if not cut.in_three:
        cut = cut_in_half(corners)
    return cut


@wp.func
def cut_places(places: Places, cut: Cut) -> Parts:
    """The parts of a piece, three or two, a row each."""
    p = places[cut.corner]
    q = places[(cut.corner + 1) % 3]
    r = places[(cut.corner + 2) % 3]
    one = p + cut.after * (q - p)
    two = p + cut.before * (r - p)
    parts = Parts()
    for axis in range(2):
        parts[0, axis] = p[axis]
        parts[0, 2 + axis] = one[axis]
        parts[0, 4 + axis] = two[axis]
        parts[1, axis] = one[axis]
        parts[1, 2 + axis] = q[axis]
        parts[1, 4 + axis] = r[axis]
        parts[2, axis] = one[axis]
        parts[2, 2 + axis] = r[axis]
        parts[2, 4 + axis] = two[axis]
    return parts


@wp.func
def keep_piece(
    piece: MeshPatches, piece_count: wp.array[wp.int32], part: wp.int32, face: wp.int32, places: Places, hints: Faces
):
    """Add a piece to those of a part, as far as there is room."""
    room = piece.face.shape[0] / piece_count.shape[0]
    if room > 0:
        place = wp.atomic_add(piece_count, part, 1)
        if place < room:
            row = part * room + place
            piece.face[row] = face
            for k in range(3):
                piece.place[row, 2 * k] = places[k, 0]
                piece.place[row, 2 * k + 1] = places[k, 1]
            for k in range(HINTS):
                piece.hint[row, k] = hints[k]


@wp.struct
class PatchDistance:
    """The largest distance of a patch, see :func:`largest_distances`, and the faces near to it."""

    low: wp.float64
    high: wp.float64
    hints: Faces


@wp.func
def patch_distance(
    own: Surface,
    other: Surface,
    face: wp.int32,
    first: wp.int32,
    patches: MeshPatches,
    patch: wp.int32,
    found_in: PatchDistance,
    part: wp.int32,
    piece_count: wp.array[wp.int32],
    piece: MeshPatches,
) -> PatchDistance:
    """The largest distance of a patch in one frame, by branch and bound; ``found_in`` is what is known before.

    ``face`` is its face in the cell of the frame, ``first`` the first face of the other mesh there.
    """
    found = found_in
    waiting = Waiting()
    for k in range(6):
        waiting[0, k] = patches.place[patch, k]
    count = wp.int32(1)
    looked_at = wp.int32(0)
    while count > 0:
        count -= 1
        places = Places()
        for k in range(6):
            places[k / 2, k % 2] = waiting[count, k]
        corners = place_corners(own, face, places)
        hint = covering_hint(other, found.hints, first, corners, found.low + ROUNDING)
        done = hint >= 0
        if done:
            found.hints = with_first(found.hints, found.hints[hint], hint)
        else:
            look = look_at_piece(other, found.hints, first, corners, found.low)
            found.low = look.low
            looked_at += wp.where(look.near >= 0, 1, 0)
            if look.near < 0:
                done = True
            elif look.bound <= found.low * (wp.float64(1.0) + TOLERANCE) + ROUNDING:
                done = True
                found.hints = with_first(found.hints, look.near - first, HINTS - 1)
                if look.bound > found.low + ROUNDING:
                    found.high = wp.max(found.high, look.bound)
            elif looked_at >= MAX_PIECES or count + 3 > MAX_WAITING:
                done = True
                found.high = wp.max(found.high, look.bound)
            else:
                cut = cut_at(other, look.near, corners)
                parts = cut_places(places, cut)
                part_count = wp.where(cut.in_three, 3, 2)
                for i in range(part_count):
                    for k in range(6):
                        waiting[count + i, k] = parts[i, k]
                count += part_count
        if done:
            keep_piece(piece, piece_count, part, patches.face[patch], places, found.hints)
    return found


@wp.kernel
def largest_distances(
    # in
    own: Surface,
    other: Surface,
    own_count: wp.int32,
    other_count: wp.int32,
    frame_count: wp.int32,
    floor: wp.array[wp.float64],
    part: wp.int32,
    first_run: wp.int32,
    # in and out
    patches: MeshPatches,
    piece_count: wp.array[wp.int32],
    # out
    piece: MeshPatches,
    low_out: wp.array2d[wp.float64],
    high_out: wp.array2d[wp.float64],
):
    """The largest distance of each patch of ``own`` from ``other``, where that is beyond the floor (n,) of the frame.

    No point of the patch is further than the larger of ``low`` and ``high``, and one is at ``low``, if that is above
    the floor. ``high`` is above ``low`` by no more than the tolerance, but where a patch was given up. The pieces that
    the patches were cut into are counted in ``piece_count`` of this part, and kept as far as ``piece`` has room for the
    part: (parts, room), in the order they are found.
    """
    run = first_run + wp.tid()
    found = PatchDistance()
    for k in range(HINTS):
        found.hints[k] = wp.int32(-1)
    for patch in range(run * RUN, wp.min((run + 1) * RUN, patches.face.shape[0])):
        if patches.hint[patch, 0] >= 0:
            for k in range(HINTS):
                found.hints[k] = patches.hint[patch, k]
        for frame in range(frame_count):
            face = frame * own_count + patches.face[patch]
            found.low = floor[frame]
            found.high = wp.float64(0.0)
            found = patch_distance(
                own, other, face, frame * other_count, patches, patch, found, part, piece_count, piece
            )
            low_out[frame, patch] = found.low
            high_out[frame, patch] = found.high
        for k in range(HINTS):
            patches.hint[patch, k] = found.hints[k]
