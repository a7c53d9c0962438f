"""Attributes of the output fitted to the input by least squares: partners of samples, right sides, iterations.

Every output face has the same S sample points, all of one weight, so that its element matrix is the face's area times
one constant 3 x 3 matrix with ``own`` on its diagonal and ``other`` elsewhere: nothing but areas is stored.
"""

import warp as wp

from warpqem.kernels.surface_walk import Hit, Surface, closest_hit, face_cross, hit_face

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# Points whose faces' normals differ by more than 78 degrees belong to different sides of a fold.
SAME_SIDE = wp.constant(wp.float32(0.2))
# A partner is near within a tenth of the face's height: further off, a walk may be stuck. Squared.
NEAR = wp.constant(wp.float32(0.01))


@wp.func
def blended(barycentric: wp.vec3, a: wp.float64, b: wp.float64, c: wp.float64) -> wp.float64:
    """A value within a face from those at its corners; just ``a`` where all three are equal."""
    return a + wp.float64(barycentric[1]) * (b - a) + wp.float64(barycentric[2]) * (c - a)


@wp.func
def is_in_front(source: Surface, face: wp.int32, normal: wp.vec3) -> wp.bool:
    """Whether a face faces the same way as a normal."""
    return wp.dot(normal, wp.normalize(face_cross(source, 0, face))) > SAME_SIDE


@wp.func
def nearer_in_front(source: Surface, hit: Hit, normal: wp.vec3, best: Hit) -> Hit:
    """``hit`` where it is nearer than ``best``, if that is one, and its face faces the same way; else ``best``."""
    if hit.face < 0 or (best.face >= 0 and hit.squared >= best.squared):
        return best
    if is_in_front(source, hit.face, normal):
        return hit
    return best


@wp.func
def hit_in_front(source: Surface, start: wp.int32, x: wp.vec3, normal: wp.vec3) -> Hit:
    """The nearest point downhill from a face.

    Where it is on a face that faces another way, beyond an edge, the walk starts again from the nearest face about the
    first one that faces the same way, if there is one.
    """
    none = wp.vec3i(-1, -1, -1)
    hit = closest_hit(source, 0, none, start, x)
    if is_in_front(source, hit.face, normal):
        return hit
    beside = Hit()
    beside.face = wp.int32(-1)
    for k in range(3):
        vertex = source.corner_vertex[3 * start + k]
        for i in range(source.adjacency_start[vertex], source.adjacency_start[vertex + 1]):
            face = source.adjacent_corner[i] / 3
            if is_in_front(source, face, normal):
                other = hit_face(source, 0, face, x)
                if beside.face < 0 or other.squared < beside.squared:
                    beside = other
    if beside.face < 0:
        return hit
    further = closest_hit(source, 0, none, beside.face, x)
    if is_in_front(source, further.face, normal):
        beside = further
    # A part that nothing faces as the sample does is gone: what is further off is another one.
    if beside.squared <= hit.squared:
        return beside
    return hit


@wp.func
def squared_height(a: wp.vec3, b: wp.vec3, c: wp.vec3, cross: wp.vec3) -> wp.float32:
    """Of a triangle, over its longest edge; 0 without one."""
    longest = wp.max(wp.length_sq(b - a), wp.max(wp.length_sq(c - b), wp.length_sq(a - c)))
    return wp.where(longest > 0.0, wp.length_sq(cross) / longest, 0.0)


@wp.kernel
def find_partners(
    # in
    first_face: wp.int32,
    source: Surface,
    start_in: wp.array[wp.int32],
    near_in: wp.array2d[wp.int32],
    corner_vertex_in: wp.array[wp.int32],
    points_in: wp.array[wp.vec3],
    barycentric_in: wp.array[wp.vec3],
    # out
    face_out: wp.array2d[wp.int32],
    weight_out: wp.array2d[wp.vec3],
):
    """The nearest point of the input for each sample of a face (f, s), downhill from where the face's corners start.

    ``start_in`` (3N',) is a face of the input for each output corner, ``near_in`` (f, s) one near the sample, -1 for
    none known. Face -1 where the input faces another way.
    """
    i, s = wp.tid()
    f = first_face + i
    barycentric = barycentric_in[s]
    a = points_in[corner_vertex_in[3 * f]]
    b = points_in[corner_vertex_in[3 * f + 1]]
    c = points_in[corner_vertex_in[3 * f + 2]]
    x = barycentric[0] * a + barycentric[1] * b + barycentric[2] * c
    cross = wp.cross(b - a, c - a)
    n = wp.normalize(cross)
    none = wp.vec3i(-1, -1, -1)
    near = NEAR * squared_height(a, b, c, cross)
    best = Hit()
    best.face = wp.int32(-1)
    if near_in[f, s] >= 0:
        best = nearer_in_front(source, closest_hit(source, 0, none, near_in[f, s], x), n, best)
    if best.face < 0:
        # From face to face, which gets along slivers that have no vertex near: from the nearest corner, and from the
        # others where that did not get near.
        first = wp.int32(wp.argmax(barycentric))
        for step in range(3):
            k = (first + step) % 3
            if best.face < 0 or best.squared > near:
                best = nearer_in_front(source, hit_in_front(source, start_in[3 * f + k], x, n), n, best)
    if best.face < 0:
        # Over vertices, which gets out of folds.
        for k in range(3):
            start = source.corner_vertex[3 * start_in[3 * f + k]]
            best = nearer_in_front(source, closest_hit(source, 0, wp.vec3i(start, -1, -1), -1, x), n, best)
    face_out[f, s] = best.face
    weight_out[f, s] = best.barycentric


@wp.kernel
def sum_misfits(
    # in
    first_face: wp.int32,
    partner_in: wp.array2d[wp.int32],
    partner_weight_in: wp.array2d[wp.vec3],
    barycentric_in: wp.array[wp.vec3],
    corner_element_in: wp.array[wp.int32],
    values_in: wp.array2d[wp.float64],
    corner_start_in: wp.array[wp.int32],
    start_in: wp.array2d[wp.float64],
    # out
    misfit_out: wp.array2d[wp.float64],
):
    """Per face and channel, for each corner the mean over the samples of its weight times what the start misses.

    The start are values (R, C), one for each output corner by ``corner_start_in`` (3N',); the input has values (E, C)
    by ``corner_element_in`` (3N,). A sample without a partner misses nothing.
    """
    i, channel = wp.tid()
    f = first_face + i
    total = wp.vec3d()
    a = start_in[corner_start_in[3 * f], channel]
    b = start_in[corner_start_in[3 * f + 1], channel]
    c = start_in[corner_start_in[3 * f + 2], channel]
    for s in range(barycentric_in.shape[0]):
        g = partner_in[f, s]
        if g >= 0:
            wanted = blended(
                partner_weight_in[f, s],
                values_in[corner_element_in[3 * g], channel],
                values_in[corner_element_in[3 * g + 1], channel],
                values_in[corner_element_in[3 * g + 2], channel],
            )
            misfit = wanted - blended(barycentric_in[s], a, b, c)
            for k in range(3):
                total[k] += wp.float64(barycentric_in[s][k]) * misfit
    for k in range(3):
        misfit_out[3 * f + k, channel] = total[k] / wp.float64(barycentric_in.shape[0])


@wp.struct
class Unknowns:
    """R values to solve for, which the corners of the output's faces share."""

    corner: wp.array[wp.int32]  # (3N',) the unknown at each corner
    adjacency_start: wp.array[wp.int32]  # (R+1,)
    adjacent_corner: wp.array[wp.int32]  # (3N',)
    area: wp.array[wp.float64]  # (N',)
    free: wp.array[wp.int32]  # (R,) 0: the value stays what it is at the start
    own: wp.float64  # mean of a corner's squared weight over the samples
    other: wp.float64  # mean of the product of two corners' weights


@wp.kernel
def start_solution(
    # in
    first: wp.int32,
    unknowns: Unknowns,
    misfit_in: wp.array2d[wp.float64],
    step: wp.float64,
    # out
    residual_out: wp.array2d[wp.float64],
    change_out: wp.array2d[wp.float64],
    direction_out: wp.array2d[wp.float64],
):
    """No change yet: the residual is the right side, and the first direction so many times that over the diagonal."""
    i, channel = wp.tid()
    u = first + i
    right = wp.float64(0.0)
    diagonal = wp.float64(0.0)
    for j in range(unknowns.adjacency_start[u], unknowns.adjacency_start[u + 1]):
        h = unknowns.adjacent_corner[j]
        right += unknowns.area[h / 3] * misfit_in[h, channel]
        diagonal += unknowns.area[h / 3] * unknowns.own
    residual_out[u, channel] = right
    change_out[u, channel] = wp.float64(0.0)
    direction_out[u, channel] = wp.float64(0.0)
    if unknowns.free[u] == 1 and diagonal > wp.float64(0.0):
        direction_out[u, channel] = step * right / diagonal


@wp.kernel
def improve_solution(
    # in
    first: wp.int32,
    unknowns: Unknowns,
    direction_in: wp.array2d[wp.float64],
    turn: wp.float64,
    step: wp.float64,
    # in and out
    residual: wp.array2d[wp.float64],
    change: wp.array2d[wp.float64],
    # out
    direction_out: wp.array2d[wp.float64],
):
    """One step of the Chebyshev iteration: along the direction, then the next one, ``turn`` times the last of which."""
    i, channel = wp.tid()
    u = first + i
    here = direction_in[u, channel]
    image = wp.float64(0.0)
    diagonal = wp.float64(0.0)
    for j in range(unknowns.adjacency_start[u], unknowns.adjacency_start[u + 1]):
        h = unknowns.adjacent_corner[j]
        f = h / 3
        around = wp.float64(0.0)
        for k in range(3):
            around += direction_in[unknowns.corner[3 * f + k], channel]
        image += unknowns.area[f] * ((unknowns.own - unknowns.other) * here + unknowns.other * around)
        diagonal += unknowns.area[f] * unknowns.own
    direction_out[u, channel] = wp.float64(0.0)
    if unknowns.free[u] == 1 and diagonal > wp.float64(0.0):
        change[u, channel] = change[u, channel] + here
        left = residual[u, channel] - image
        residual[u, channel] = left
        direction_out[u, channel] = turn * here + step * left / diagonal


@wp.kernel
def solve_channel(
    # in
    first: wp.int32,
    corner_in: wp.array[wp.int32],
    area_in: wp.array[wp.float64],
    free_in: wp.array[wp.int32],
    own: wp.float64,
    other: wp.float64,
    misfit_in: wp.array2d[wp.float64],
    begin: wp.float64,
    schedule_in: wp.array2d[wp.float64],
    # in and out
    unknown: wp.array3d[wp.float64],
    # out
    change_out: wp.array2d[wp.float64],
):
    """All steps of one channel: what ``start_solution`` and ``improve_solution`` do, to the same bits.

    Sums go over faces, each of which is read once, where those go over the faces of each unknown, which takes a thread
    four times as long. ``schedule_in`` (steps, 2) are ``turn`` and ``step``, ``begin`` the step of the start,
    ``unknown`` (C, 4, R) the residual, the direction, the diagonal and the image, all 0 before, as the change is.
    """
    channel = first + wp.tid()
    for f in range(area_in.shape[0]):
        area = area_in[f]
        for k in range(3):
            h = 3 * f + k
            u = corner_in[h]
            unknown[channel, 0, u] = unknown[channel, 0, u] + area * misfit_in[h, channel]
            unknown[channel, 2, u] = unknown[channel, 2, u] + area * own
    for u in range(free_in.shape[0]):
        if free_in[u] == 1 and unknown[channel, 2, u] > wp.float64(0.0):
            unknown[channel, 1, u] = begin * unknown[channel, 0, u] / unknown[channel, 2, u]
    for i in range(schedule_in.shape[0]):
        turn = schedule_in[i, 0]
        step = schedule_in[i, 1]
        for f in range(area_in.shape[0]):
            area = area_in[f]
            around = wp.float64(0.0)
            for k in range(3):
                around += unknown[channel, 1, corner_in[3 * f + k]]
            for k in range(3):
                u = corner_in[3 * f + k]
                image = area * ((own - other) * unknown[channel, 1, u] + other * around)
                unknown[channel, 3, u] = unknown[channel, 3, u] + image
        for u in range(free_in.shape[0]):
            if free_in[u] == 1 and unknown[channel, 2, u] > wp.float64(0.0):
                here = unknown[channel, 1, u]
                change_out[u, channel] = change_out[u, channel] + here
                left = unknown[channel, 0, u] - unknown[channel, 3, u]
                unknown[channel, 0, u] = left
                unknown[channel, 1, u] = turn * here + step * left / unknown[channel, 2, u]
            unknown[channel, 3, u] = wp.float64(0.0)
