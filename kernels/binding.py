"""Where on a reference surface a vertex belongs: walks that stay on a sheet, and searches that mind which way it faces.

All in double precision, on points scaled to about unit size around the origin.
"""

import warp as wp

from warpqem.kernels.closest_point import closest_on_face, segment_parameter, single_point

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# Times that the box of a search doubles at most: from a rounding error of the points, 1e-7, to their whole extent.
MAX_DOUBLINGS = wp.constant(24)


@wp.kernel
def walk_surface(
    # in
    points: wp.array[wp.vec3d],
    corner_vertex: wp.array[wp.int32],
    ring_start: wp.array[wp.int32],
    ring_end: wp.array[wp.int32],
    ring_corner: wp.array[wp.int32],
    start_face: wp.array[wp.int32],
    query: wp.array[wp.vec3d],
    step_limit: wp.int32,
    # out
    face_out: wp.array[wp.int32],
    barycentric_out: wp.array[wp.vec3d],
):
    """The point of a surface nearest to each query, downhill from a start face over faces that meet at a vertex.

    ``ring_corner`` holds the corners around each corner, from ``ring_start`` to ``ring_end``. A step looks at the faces
    around every vertex that the nearest point so far has a weight of; it ends where none is nearer. With a limit of 0
    steps it is the point of the start face. A start of -1 gives face -1.
    """
    i = wp.tid()
    face_out[i] = start_face[i]
    if start_face[i] < 0:
        return
    p = query[i]
    best = closest_on_face(points, corner_vertex, start_face[i], p)
    for _ in range(step_limit):
        here = best.face
        at = best.barycentric
        # A point inside a face is nearest among all faces around it: only edges and corners lead further.
        if at[0] > wp.float64(0.0) and at[1] > wp.float64(0.0) and at[2] > wp.float64(0.0):
            break
        for k in range(3):
            if at[k] > wp.float64(0.0):
                for entry in range(ring_start[3 * here + k], ring_end[3 * here + k]):
                    other = closest_on_face(points, corner_vertex, ring_corner[entry] / 3, p)
                    if other.squared < best.squared:
                        best = other
        if best.face == here:
            break
    face_out[i] = best.face
    barycentric_out[i] = best.barycentric


@wp.func
def faces_along(
    points: wp.array[wp.vec3d], corner_vertex: wp.array[wp.int32], face: wp.int32, direction: wp.vec3d
) -> wp.bool:
    """Whether a face faces along a direction; one of length 0 is any."""
    a = points[corner_vertex[3 * face]]
    b = points[corner_vertex[3 * face + 1]]
    c = points[corner_vertex[3 * face + 2]]
    any_way = wp.dot(direction, direction) == wp.float64(0.0)
    return any_way or wp.dot(wp.cross(b - a, c - a), direction) > wp.float64(0.0)


@wp.kernel
def find_facing(
    # in
    mesh: wp.uint64,
    points: wp.array[wp.vec3d],
    corner_vertex: wp.array[wp.int32],
    query: wp.array[wp.vec3d],
    normal: wp.array[wp.vec3d],
    face_label: wp.array[wp.int32],
    label: wp.array[wp.int32],
    nearest: wp.array[wp.float64],
    reach: wp.array[wp.float64],
    # out
    face_out: wp.array[wp.int32],
):
    """The nearest face to each query of its label that faces its way, no further than ``reach``; -1: there is none.

    Label -1 is any; a normal of length 0 is any way. ``nearest`` is the distance of the surface whichever way it faces:
    no search needs a smaller box.
    """
    i = wp.tid()
    p = query[i]
    centre = single_point(p)
    best = wp.int32(-1)
    best_squared = reach[i] * reach[i]
    # Room for the single precision of the hierarchy's boxes.
    radius = wp.min(wp.float64(2.0) * nearest[i] + wp.float64(1.0e-6), reach[i])
    for _ in range(MAX_DOUBLINGS):
        extent = wp.vec3(wp.float32(radius), wp.float32(radius), wp.float32(radius))
        found = wp.mesh_query_aabb(mesh, centre - extent, centre + extent)
        face = wp.int32(0)
        while wp.mesh_query_next(found, face):
            facing = faces_along(points, corner_vertex, face, normal[i])
            if facing and (label[i] < 0 or face_label[face] == label[i]):
                squared = closest_on_face(points, corner_vertex, face, p).squared
                if squared < best_squared or (squared == best_squared and face < best):
                    best = face
                    best_squared = squared
        # What the box holds is nearest only if it is no further away than the box reaches.
        if (best >= 0 and best_squared <= radius * radius) or radius >= reach[i]:
            break
        radius = wp.min(wp.float64(2.0) * radius, reach[i])
    face_out[i] = best


@wp.kernel
def find_listed(
    # in
    list_start: wp.array[wp.int32],
    list_face: wp.array[wp.int32],
    points: wp.array[wp.vec3d],
    corner_vertex: wp.array[wp.int32],
    query: wp.array[wp.vec3d],
    normal: wp.array[wp.vec3d],
    # out
    face_out: wp.array[wp.int32],
    distance_out: wp.array[wp.float64],
):
    """The nearest face of each query's own list that faces its way, the first of equal ones; -1: there is none.

    A normal of length 0 is any way.
    """
    i = wp.tid()
    best = wp.int32(-1)
    best_squared = wp.float64(wp.inf)
    for entry in range(list_start[i], list_start[i + 1]):
        face = list_face[entry]
        if faces_along(points, corner_vertex, face, normal[i]):
            squared = closest_on_face(points, corner_vertex, face, query[i]).squared
            if squared < best_squared:
                best = face
                best_squared = squared
    face_out[i] = best
    distance_out[i] = wp.sqrt(best_squared)


@wp.kernel
def find_nearest_segments(
    # in
    query: wp.array[wp.vec3d],
    start: wp.array[wp.vec3d],
    end: wp.array[wp.vec3d],
    # out
    distance_out: wp.array[wp.float64],
):
    """The distance of each query from the nearest segment; all are looked at, since seams have few."""
    i = wp.tid()
    p = query[i]
    best = wp.float64(wp.inf)
    for k in range(start.shape[0]):
        a = start[k]
        b = end[k]
        offset = (p - a) - segment_parameter(p, a, b) * (b - a)
        best = wp.min(best, wp.dot(offset, offset))
    distance_out[i] = wp.sqrt(best)
