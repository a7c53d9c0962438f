"""Distances between two surfaces in several cells at once at samples, and faces that oppose the other surface.

Cells are the frames of a mesh, so far apart that the nearest face of a point is one of its own cell, or several meshes
in one frame, each with a hierarchy of its own.
"""

import warp as wp

from warpqem.kernels.near_faces import (
    ANYWHERE,
    SEARCH_MARGIN,
    CellTable,
    Surface,
    corner_point,
    exactly_nearest,
    nearer_face,
    of_cell,
    squared_distance,
)
from warpqem.kernels.piece_cuts import Corners

# No gradients are taken. Loops stay loops: unrolled, they take several times as long to compile and run no faster.
wp.set_module_options({"enable_backward": False, "max_unroll": 1})

# The search is in single precision, which may pick the other one of two faces that are as near to 2e-7. Below this
# distance that is more than a fifth of a percent of it, and the choice is made again in double precision.
EXACT_BELOW = wp.constant(wp.float64(1.0e-4))
# A search of this radius finds whatever there is; its square fits single precision.
SEARCH_RADIUS = wp.constant(1.0e15)
# Two faces whose normals have a cosine below this are the two sides of one spot.
OPPOSITE = wp.constant(wp.float64(-0.99))


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
        here = wp.int32(0)
        while wp.mesh_query_next(query, here):
            face = other.first + here
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
    others: Surface,
    own_cells: CellTable,
    other_cells: CellTable,
    sample_face: wp.array[wp.int32],
    sample_place: wp.array[wp.vec2d],
    first_cell: wp.int32,
    cell_samples: wp.int32,
    hint: wp.array[wp.int32],
    first_sample: wp.int32,
    # out
    distance_out: wp.array[wp.float64],
    angle_out: wp.array[wp.float64],
    near_out: wp.array[wp.int32],
):
    """Distance of samples from the other surface, and the angle between the normals of both faces, in degrees.

    There are ``cell_samples`` in each cell from ``first_cell`` on; faces are counted from the first one of the cell.
    ``sample_place`` (S,) are the barycentric coordinates of the second and third corner. Of a surface with two sides on
    the same points, the one that faces the sample's way counts. A distance is -1 where the search finds no face of the
    sample's cell, as all of them are slivers. ``hint`` (N,) are faces of one cell of ``others`` that may be near to
    each face of ``own``, -1 for none: they bound the search, and decide nothing. It may be empty.
    """
    i = first_sample + wp.tid()
    cell = first_cell + i / cell_samples
    other = of_cell(others, other_cells, cell)
    first = other_cells.first_face[cell]
    face = own_cells.first_face[cell] + sample_face[i]
    place = sample_place[i]
    a = corner_point(own, face, 0)
    b = corner_point(own, face, 1)
    c = corner_point(own, face, 2)
    p = a + place[0] * (b - a) + place[1] * (c - a)
    radius = SEARCH_RADIUS
    known = wp.int32(-1)
    if hint.shape[0] > 0:
        known = hint[sample_face[i]]
    if known >= 0:
        known += first
        radius = wp.float32(wp.sqrt(squared_distance(other, known, p)) + SEARCH_MARGIN)
    centre = wp.vec3(wp.float32(p[0]), wp.float32(p[1]), wp.float32(p[2]))
    found = wp.mesh_query_point_no_sign(other.mesh, centre, radius)
    if not found.result:
        # The search passes over slivers, of which the one that is known may be one.
        found = wp.mesh_query_point_no_sign(other.mesh, centre, SEARCH_RADIUS)
    near_out[i] = wp.int32(-1)
    distance_out[i] = wp.float64(-1.0)
    angle_out[i] = wp.float64(0.0)
    # Cells are so far apart that a face of another one is the nearest only where there is none here.
    is_here = wp.bool(False)
    nearest = other.first + found.face
    if found.result:
        is_here = nearest >= first and nearest < other_cells.first_face[cell + 1]
    if is_here:
        squared = squared_distance(other, nearest, p)
        if squared < EXACT_BELOW * EXACT_BELOW:
            nearest = exactly_nearest(other, nearest, squared, p)
            squared = squared_distance(other, nearest, p)
        distance_out[i] = wp.sqrt(squared)
        normal = face_normal(own, face)
        near = side_facing(other, nearest, squared, p, normal)
        near_out[i] = near - first
        # A face without area has no normal, which counts as a right angle.
        cosine = wp.dot(wp.normalize(normal), wp.normalize(face_normal(other, near)))
        angle_out[i] = wp.degrees(wp.acos(wp.clamp(cosine, wp.float64(-1.0), wp.float64(1.0))))


@wp.kernel
def find_flips(
    # in
    own: Surface,
    others: Surface,
    own_cells: CellTable,
    other_cells: CellTable,
    face_cell: wp.array[wp.int32],
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

    -1 for the others. Of a surface with two sides on the same points, a face opposes neither. ``face_cell`` (N,) is the
    cell of each face in the first frame; those of the next frames follow. ``nearest`` (N,) is the nearest face when it
    was last looked for, -1 for none; it bounds the search. Faces of ``others`` are counted from the first one of the
    cell.
    """
    face = first_face + wp.tid()
    near = nearest[face]
    place = face - own_cells.first_face[face_cell[face]]
    for frame in range(frame_count):
        cell = face_cell[face] + frame
        cell_face = own_cells.first_face[cell] + place
        other = of_cell(others, other_cells, cell)
        first = other_cells.first_face[cell]
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
