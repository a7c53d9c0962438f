"""Least squares of the output surface against the input surface: pairs of points, and one element matrix per face.

Unknown is one correction ``c_v`` per output vertex, constant over all frames in the material frame ``R_v^t``. A pair
of a point of the output, with barycentric weights ``b`` in one face, and a point of the input asks that

    n . sum_k b_k R_k c_k = r

with ``n`` a normal at the pair and ``r`` how far the input lies ahead along it (point-to-plane residual). Every face
sums its pairs into one 9 x 9 matrix, in the order of the pairs, so that the sum does not depend on threads.
"""

import warp as wp

from warpqem.kernels.surface_pairs import Pairs

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# The edge term weighs 1 / length^4; edges shorter than 3 % of the mean count as that long.
SHORTEST_SQUARED = wp.constant(wp.float32(1.0e-3))

# What is known of the sizes of an output, as float32 of one array: the mean squared length of its edges, what pairs of
# the input weigh, those of the output, and edges; the mass of a unit of area; how wide borders and seams count.
EDGE_SQUARED = wp.constant(wp.int32(0))
INPUT_WEIGHT = wp.constant(wp.int32(1))
OUTPUT_WEIGHT = wp.constant(wp.int32(2))
EDGE_WEIGHT = wp.constant(wp.int32(3))
MASS = wp.constant(wp.int32(4))
BORDER_WIDTH = wp.constant(wp.int32(5))
SEAM_WIDTH = wp.constant(wp.int32(6))
SIZES = wp.constant(wp.int32(7))

# What is known of a look at vertices of far places, as int32 of one array: how many there are, whether some were held
# back the last time, whether there is anything to fit, and large faces that were to be looked at.
FAR_COUNT = wp.constant(wp.int32(0))
ANY_HELD = wp.constant(wp.int32(1))
HAS_AREA = wp.constant(wp.int32(2))
LARGE_COUNT = wp.constant(wp.int32(3))
LOOK = wp.constant(wp.int32(4))

# Keeps the matrix of a vertex without pairs from being singular (weights are of order one).
MIN_STIFFNESS = wp.constant(wp.float32(1.0e-6))


@wp.struct
class Element:
    """Normal equations of one face: the blocks on and above the diagonal, and the right side."""

    m00: wp.mat33
    m01: wp.mat33
    m02: wp.mat33
    m11: wp.mat33
    m12: wp.mat33
    m22: wp.mat33
    r0: wp.vec3
    r1: wp.vec3
    r2: wp.vec3


@wp.func
def include_row(e: Element, j0: wp.vec3, j1: wp.vec3, j2: wp.vec3, target: wp.float32, weight: wp.float32) -> Element:
    """Add the equation ``j . c = target``."""
    a = weight * j0
    b = weight * j1
    c = weight * j2
    e.m00 += wp.outer(a, j0)
    e.m01 += wp.outer(a, j1)
    e.m02 += wp.outer(a, j2)
    e.m11 += wp.outer(b, j1)
    e.m12 += wp.outer(b, j2)
    e.m22 += wp.outer(c, j2)
    e.r0 += target * a
    e.r1 += target * b
    e.r2 += target * c
    return e


@wp.func
def include_pair(
    e: Element,
    pairs: Pairs,
    i: wp.int32,
    scale: wp.float32,
    v: wp.vec3i,
    frame: wp.array2d[wp.mat33],
    correction: wp.array[wp.vec3],
    doubt: wp.float32,
) -> Element:
    """Add the equation of a pair, for the whole correction rather than what is still missing of it.

    A pair counts for less the further it is apart, for half at ``doubt ** -0.5``.
    """
    t = pairs.key[i]
    b = pairs.barycentric[i]
    n = pairs.normal[i]
    weight = scale * pairs.weight[i] / (1.0 + doubt * pairs.residual[i] * pairs.residual[i])
    # n^T R, times the weight of the corner.
    j0 = b[0] * (wp.transpose(frame[t, v[0]]) * n)
    j1 = b[1] * (wp.transpose(frame[t, v[1]]) * n)
    j2 = b[2] * (wp.transpose(frame[t, v[2]]) * n)
    done = wp.dot(j0, correction[v[0]]) + wp.dot(j1, correction[v[1]]) + wp.dot(j2, correction[v[2]])
    return include_row(e, j0, j1, j2, pairs.residual[i] + done, weight)


@wp.kernel
def assemble_elements(
    # in
    corner_vertex_in: wp.array[wp.int32],
    input_pairs: Pairs,
    input_start_in: wp.array[wp.int32],
    input_order_in: wp.array[wp.int32],
    output_pairs: Pairs,
    sizes_in: wp.array[wp.float32],
    points_in: wp.array2d[wp.vec3],
    frame_in: wp.array2d[wp.mat33],
    correction_in: wp.array[wp.vec3],
    doubt: wp.float32,
    # out
    block_out: wp.array2d[wp.mat33],
    diagonal_out: wp.array2d[wp.mat33],
    share_out: wp.array[wp.float32],
    right_out: wp.array[wp.vec3],
):
    """The nine blocks and three right sides of each face; ``sizes_in`` (SIZES,) says what pairs and edges weigh.

    Those on the diagonal stand apart, as how far vertices are held is added to them (:func:`hold_elements`), by the
    share of the area that a corner of the face has; all pairs of a unit of area weigh its mass.
    """
    f = wp.tid()
    v = wp.vec3i(corner_vertex_in[3 * f], corner_vertex_in[3 * f + 1], corner_vertex_in[3 * f + 2])
    e = Element()
    input_weight = sizes_in[INPUT_WEIGHT]
    output_weight = sizes_in[OUTPUT_WEIGHT]
    mean_edge_squared = sizes_in[EDGE_SQUARED]
    for k in range(input_start_in[f], input_start_in[f + 1]):
        e = include_pair(e, input_pairs, input_order_in[k], input_weight, v, frame_in, correction_in, doubt)
    per_face = output_pairs.face.shape[0] / (corner_vertex_in.shape[0] / 3)
    for i in range(f * per_face, (f + 1) * per_face):
        if output_pairs.face[i] >= 0:
            e = include_pair(e, output_pairs, i, output_weight, v, frame_in, correction_in, doubt)
    none = wp.vec3()
    area = wp.float32(0.0)
    for t in range(points_in.shape[0]):
        area += 0.5 * wp.length(
            wp.cross(points_in[t, v[1]] - points_in[t, v[0]], points_in[t, v[2]] - points_in[t, v[0]])
        )
        for k in range(3):
            a = v[k]
            b = v[(k + 1) % 3]
            d = points_in[t, a] - points_in[t, b]
            squared = wp.max(wp.dot(d, d), SHORTEST_SQUARED * mean_edge_squared)
            weight = sizes_in[EDGE_WEIGHT] * mean_edge_squared / (squared * squared)
            # d . (R_a c_a - R_b c_b): how much longer the edge gets, times its length.
            ja = wp.transpose(frame_in[t, a]) * d
            jb = -(wp.transpose(frame_in[t, b]) * d)
            if k == 0:
                e = include_row(e, ja, jb, none, 0.0, weight)
            elif k == 1:
                e = include_row(e, none, ja, jb, 0.0, weight)
            else:
                e = include_row(e, jb, none, ja, 0.0, weight)
    # By area and not by the pairs found: where there is none, the regularisation alone determines a vertex.
    share_out[f] = area * sizes_in[MASS] / (3.0 * wp.float32(points_in.shape[0]))
    diagonal_out[f, 0] = e.m00
    diagonal_out[f, 1] = e.m11
    diagonal_out[f, 2] = e.m22
    block_out[f, 1] = e.m01
    block_out[f, 2] = e.m02
    block_out[f, 3] = wp.transpose(e.m01)
    block_out[f, 5] = e.m12
    block_out[f, 6] = wp.transpose(e.m02)
    block_out[f, 7] = wp.transpose(e.m12)
    right_out[3 * f] = e.r0
    right_out[3 * f + 1] = e.r1
    right_out[3 * f + 2] = e.r2


@wp.kernel
def hold_elements(
    # in
    corner_vertex_in: wp.array[wp.int32],
    diagonal_in: wp.array2d[wp.mat33],
    share_in: wp.array[wp.float32],
    stiffness: wp.vec3,
    hold_in: wp.array[wp.vec3],
    # out
    block_out: wp.array2d[wp.mat33],
):
    """The blocks on the diagonal with ``stiffness`` of a correction's coordinates, times how far a vertex is held."""
    f = wp.tid()
    along = share_in[f] * stiffness
    nothing = MIN_STIFFNESS * wp.vec3(1.0, 1.0, 1.0)
    for k in range(3):
        hold = hold_in[corner_vertex_in[3 * f + k]]
        block_out[f, 4 * k] = diagonal_in[f, k] + wp.diag(wp.cw_mul(along, hold) + nothing)


@wp.kernel
def raise_holds(
    # in
    marked_in: wp.array[wp.int32],
    stiffness_in: wp.array[wp.vec3],
    factor: wp.float32,
    largest: wp.float32,
    # in and out
    held: wp.array[wp.float32],
    hold: wp.array[wp.vec3],
    any_marked: wp.array[wp.int32],
):
    """Hold marked vertices (C,) ``factor`` times as much, and those held so much already without an end.

    ``hold`` is their stiffness times that, or ``largest`` times it; ``any_marked`` (1,) becomes 1 if there are some.
    """
    v = wp.tid()
    if marked_in[v] != 0:
        more = wp.where(held[v] < factor, factor * held[v], wp.inf)
        held[v] = more
        hold[v] = wp.min(more, largest) * stiffness_in[v]
        any_marked[0] = 1


@wp.kernel
def note_look(
    # in
    far_in: wp.array[wp.int32],
    any_held_in: wp.array[wp.int32],
    has_area_in: wp.array[wp.int32],
    large_count_in: wp.array[wp.int32],
    # out
    look_out: wp.array[wp.int32],
):
    """What is known of a look that marked some of C vertices as far, (LOOK,), zero before."""
    v = wp.tid()
    if far_in[v] != 0:
        wp.atomic_add(look_out, int(FAR_COUNT), 1)
    if v == 0:
        look_out[int(ANY_HELD)] = any_held_in[0]
        look_out[int(HAS_AREA)] = has_area_in[0]
        look_out[int(LARGE_COUNT)] = large_count_in[0]


@wp.kernel
def count_times_far(
    # in
    far_in: wp.array[wp.int32],
    look_in: wp.array[wp.int32],
    most: wp.int32,
    room: wp.int32,
    # in and out
    times: wp.array[wp.int32],
    # out
    rings_out: wp.array[wp.int32],
):
    """How often each vertex (C,) that is far was far, 0 of others, where a look is complete; else 0 of all.

    It is complete where nothing was held back the last time, no more than ``room`` large faces were to be looked at,
    and no more than ``most`` vertices are far, which asks for more than holding them.
    """
    v = wp.tid()
    is_held = look_in[int(ANY_HELD)] != 0 or look_in[int(HAS_AREA)] == 0
    is_complete = not is_held and look_in[int(LARGE_COUNT)] <= room and look_in[int(FAR_COUNT)] <= most
    rings = wp.int32(0)
    if is_complete and far_in[v] != 0:
        rings = times[v] + 1
        times[v] = rings
    rings_out[v] = rings


@wp.kernel
def widen_rings(
    # in
    corner_vertex_in: wp.array[wp.int32],
    # in and out
    rings: wp.array[wp.int32],
):
    """Give the vertices of each face one ring less at least than any of them has, (C,).

    A launch for each ring beyond the first makes them final; until then they are no more than that.
    """
    f = wp.tid()
    a, b, c = corner_vertex_in[3 * f], corner_vertex_in[3 * f + 1], corner_vertex_in[3 * f + 2]
    least = wp.max(rings[a], wp.max(rings[b], rings[c])) - 1
    if least > 0:
        wp.atomic_max(rings, a, least)
        wp.atomic_max(rings, b, least)
        wp.atomic_max(rings, c, least)


@wp.kernel
def take_held(
    # in
    any_marked_in: wp.array[wp.int32],
    held_in: wp.array[wp.float32],
    solution_in: wp.array[wp.vec3],
    # in and out
    correction: wp.array[wp.vec3],
):
    """The solution, but none of it at vertices held without an end; what there was if none was marked."""
    v = wp.tid()
    if any_marked_in[0] != 0:
        correction[v] = wp.where(wp.isinf(held_in[v]), 0.0, 1.0) * solution_in[v]


@wp.kernel
def sum_face_sizes(
    # in
    points_in: wp.array2d[wp.vec3],
    corner_vertex_in: wp.array[wp.int32],
    # out
    sum_out: wp.array2d[wp.float64],
):
    """Areas of faces, and squared lengths of their edges, in some frames: (n, 2), sums over every n-th face each."""
    first = wp.tid()
    area = wp.float64(0.0)
    squared = wp.float64(0.0)
    for f in range(first, corner_vertex_in.shape[0] / 3, sum_out.shape[0]):
        for t in range(points_in.shape[0]):
            a = points_in[t, corner_vertex_in[3 * f]]
            ab = points_in[t, corner_vertex_in[3 * f + 1]] - a
            ac = points_in[t, corner_vertex_in[3 * f + 2]] - a
            area += wp.float64(0.5 * wp.length(wp.cross(ab, ac)))
            squared += wp.float64(wp.length_sq(ab)) + wp.float64(wp.length_sq(ac)) + wp.float64(wp.length_sq(ac - ab))
    sum_out[first, 0] = area
    sum_out[first, 1] = squared


@wp.struct
class SizeShares:
    """What sizes come to, see :mod:`warpqem.refit.scales`."""

    vertex_count: wp.float64
    turns: wp.float64
    output_share: wp.float64
    edge_weight: wp.float64
    border_width: wp.float64
    seam_width: wp.float64


@wp.kernel
def weigh_sizes(
    # in
    sum_in: wp.array2d[wp.float64],
    frame_count: wp.float64,
    edge_count: wp.float64,
    shares: SizeShares,
    # out
    size_out: wp.array[wp.float32],
    has_area_out: wp.array[wp.int32],
):
    """One thread: add the sums (n, 2) of areas and squared edges in order; without an area all that weighs is 0."""
    area = wp.float64(0.0)
    squared = wp.float64(0.0)
    for i in range(sum_in.shape[0]):
        area += sum_in[i, 0]
        squared += sum_in[i, 1]
    area = area / frame_count
    squared = squared / (frame_count * edge_count)
    for i in range(SIZES):
        size_out[i] = wp.float32(0.0)
    has_area_out[0] = 0
    # No length is compared with zero, nor divided by it.
    size_out[EDGE_SQUARED] = wp.float32(1.0)
    if area > wp.float64(0.0):
        unit = shares.vertex_count / (area * shares.turns)
        length = wp.sqrt(squared)
        size_out[EDGE_SQUARED] = wp.float32(squared)
        size_out[INPUT_WEIGHT] = wp.float32(unit)
        size_out[OUTPUT_WEIGHT] = wp.float32(shares.output_share * unit)
        size_out[EDGE_WEIGHT] = wp.float32(shares.edge_weight)
        size_out[MASS] = wp.float32((wp.float64(1.0) + shares.output_share) * shares.turns * unit)
        size_out[BORDER_WIDTH] = wp.float32(shares.border_width * length)
        size_out[SEAM_WIDTH] = wp.float32(shares.seam_width * length)
        has_area_out[0] = 1
