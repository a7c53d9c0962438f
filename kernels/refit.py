"""Least squares of the output surface against the input surface: pairs of points, and one element matrix per face.

Unknown is one correction ``c_v`` per output vertex, constant over all frames in the material frame ``R_v^t``. A pair
of a point of the output, with barycentric weights ``b`` in one face, and a point of the input asks that

    n . sum_k b_k R_k c_k = r

with ``n`` a normal at the pair and ``r`` how far the input lies ahead along it (point-to-plane residual). Every face
sums its pairs into one 9 x 9 matrix, in the order of the pairs, so that the sum does not depend on threads.
"""

import warp as wp

from warpqem.kernels.material_frame import first_tangent
from warpqem.kernels.surface_walk import (
    Surface,
    closest_border_hit,
    closest_hit,
    face_cross,
    search_nearer,
    surface_point,
)
from warpqem.kernels.topology import half_edge_target

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# Points whose normals differ by more than 78 degrees belong to different sides of a fold.
SAME_SIDE = wp.constant(wp.float32(0.2))

# A pair lies ahead of each other when its offset is within 73 degrees of the normal: this is the square of the cosine.
# At the rim of a fold a walk ends beside the surface, and such a pair would drag the rim along.
AHEAD = wp.constant(wp.float32(0.08))

# Share of the input's area that its vertices stand for; the middles of its faces stand for the rest. Three quarters
# for the middles: a triangle's quadrature that is exact for quadratic functions weighs them like this.
VERTEX_SHARE = wp.constant(wp.float32(0.25))

# The edge term weighs 1 / length^4; edges shorter than 3 % of the mean count as that long.
SHORTEST_SQUARED = wp.constant(wp.float32(1.0e-3))

# Keeps the matrix of a vertex without pairs from being singular (weights are of order one).
MIN_PULL = wp.constant(wp.float32(1.0e-6))


@wp.struct
class Pairs:
    """Pairs of points: the output face and frame, weights in the face, normal, residual, weight, where to walk from."""

    face: wp.array[wp.int32]  # -1: no pair
    key: wp.array[wp.int32]
    barycentric: wp.array[wp.vec3]
    normal: wp.array[wp.vec3]
    residual: wp.array[wp.float32]
    weight: wp.array[wp.float32]
    near: wp.array[wp.int32]  # face where the walk before ended, -1 before the first


@wp.struct
class Pull:
    """Regularisation weights of corrections, relative to the area a vertex stands for."""

    tangent: wp.float32
    normal: wp.float32
    mass: wp.float32  # what all pairs of a unit of area weigh


@wp.struct
class Turns:
    """Which pairs a launch finds: those of one key frame. Samples take turns, so that all frames are met."""

    first: wp.int32  # of the launch's part of the frame's pairs
    count: wp.int32  # pairs of each sample
    key: wp.int32
    key_count: wp.int32


@wp.func
def own_pair(turns: Turns, i: wp.int32) -> wp.int32:
    """Pair number ``i`` of the frame: turn ``k`` of sample ``s`` is in frame ``s + k (key_count / count)``, cyclic."""
    turn = i % turns.count
    first_sample = (turns.key + turns.key_count - turn * (turns.key_count / turns.count)) % turns.key_count
    return (first_sample + (i / turns.count) * turns.key_count) * turns.count + turn


@wp.func
def are_partners(offset: wp.vec3, reach: wp.float32, normal: wp.vec3, other_normal: wp.vec3) -> wp.bool:
    """Whether two points are near enough, face the same way, and lie ahead of each other rather than aside."""
    ahead = wp.dot(normal, offset)
    squared = wp.length_sq(offset)
    return squared <= reach * reach and wp.dot(normal, other_normal) > SAME_SIDE and ahead * ahead >= AHEAD * squared


@wp.func
def face_corners(s: Surface, face: wp.int32) -> wp.vec3i:
    """The vertices of a face."""
    return wp.vec3i(s.corner_vertex[3 * face], s.corner_vertex[3 * face + 1], s.corner_vertex[3 * face + 2])


@wp.func
def nearest_corner(barycentric: wp.vec3) -> wp.int32:
    """The corner of a face that weighs most."""
    corner = wp.int32(0)
    for k in range(1, 3):
        if barycentric[k] > barycentric[corner]:
            corner = k
    return corner


@wp.func
def starts(start: wp.array[wp.int32], v: wp.vec3i) -> wp.vec3i:
    """Where walks from three vertices start on the other surface."""
    return wp.vec3i(start[v[0]], start[v[1]], start[v[2]])


@wp.kernel
def match_input_samples(
    # in
    turns: Turns,
    reach: wp.float32,
    source: Surface,
    target: Surface,
    start_in: wp.array[wp.int32],
    mesh: wp.uint64,
    # in and out
    pairs: Pairs,
):
    """Pair the input's face middles and vertices with the nearest points of the output.

    ``start_in`` is an output vertex near each input vertex, -1 at a vertex without a face; ``mesh`` is the hierarchy of
    the output in this frame, 0 for none.
    """
    pair = own_pair(turns, turns.first + wp.tid())
    if pair >= pairs.face.shape[0]:
        return
    sample = pair / turns.count
    t = turns.key
    face_count = source.corner_vertex.shape[0] / 3
    if sample >= face_count + source.adjacency_start.shape[0] - 1:
        return
    pairs.face[pair] = -1
    normal = wp.vec3()
    x = wp.vec3()
    area = wp.float32(0.0)
    corners = wp.vec3i()
    if sample < face_count:
        corners = face_corners(source, sample)
        x = surface_point(source, t, sample, wp.vec3(1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0))
        normal = face_cross(source, t, sample)
        area = 0.5 * (1.0 - VERTEX_SHARE) * wp.length(normal)
    else:
        v = sample - face_count
        corners = wp.vec3i(v, v, v)
        x = source.points[t, v]
        for i in range(source.adjacency_start[v], source.adjacency_start[v + 1]):
            cross = face_cross(source, t, source.adjacent_corner[i] / 3)
            normal += cross
            area += VERTEX_SHARE / 6.0 * wp.length(cross)
    if area == 0.0:
        return
    hit = closest_hit(target, t, starts(start_in, corners), pairs.near[pair], x)
    if hit.face < 0:
        return
    n = wp.normalize(face_cross(target, t, hit.face))
    offset = x - surface_point(target, t, hit.face, hit.barycentric)
    if mesh != wp.uint64(0) and not are_partners(offset, reach, n, wp.normalize(normal)):
        hit = search_nearer(mesh, x, hit)
        n = wp.normalize(face_cross(target, t, hit.face))
        offset = x - surface_point(target, t, hit.face, hit.barycentric)
    pairs.near[pair] = hit.face
    if are_partners(offset, reach, n, wp.normalize(normal)):
        pairs.face[pair] = hit.face
        pairs.key[pair] = t
        pairs.barycentric[pair] = hit.barycentric
        pairs.normal[pair] = n
        pairs.residual[pair] = wp.dot(n, offset)
        pairs.weight[pair] = area


@wp.kernel
def match_output_samples(
    # in
    turns: Turns,
    reach: wp.float32,
    source: Surface,
    target: Surface,
    start_in: wp.array[wp.int32],
    mesh: wp.uint64,
    barycentric_in: wp.array[wp.vec3],
    # in and out
    pairs: Pairs,
):
    """Pair points of every output face, at the given barycentric weights, with the nearest points of the input.

    A point without a partner is paired all the same: left out, it would let a face of a part of few faces go anywhere.
    ``start_in`` is an input vertex near each output vertex; ``mesh`` is the hierarchy of the input in this frame, 0 for
    none.
    """
    pair = own_pair(turns, turns.first + wp.tid())
    if pair >= pairs.face.shape[0]:
        return
    sample = pair / turns.count
    t = turns.key
    per_face = barycentric_in.shape[0]
    face = sample / per_face
    barycentric = barycentric_in[sample % per_face]
    x = surface_point(target, t, face, barycentric)
    start = start_in[target.corner_vertex[3 * face + nearest_corner(barycentric)]]
    hit = closest_hit(source, t, wp.vec3i(start, -1, -1), pairs.near[pair], x)
    pairs.face[pair] = -1
    if hit.face < 0:
        return
    cross = face_cross(target, t, face)
    n = wp.normalize(face_cross(source, t, hit.face))
    offset = surface_point(source, t, hit.face, hit.barycentric) - x
    if mesh != wp.uint64(0) and not are_partners(offset, reach, n, wp.normalize(cross)):
        hit = search_nearer(mesh, x, hit)
        n = wp.normalize(face_cross(source, t, hit.face))
        offset = surface_point(source, t, hit.face, hit.barycentric) - x
    pairs.near[pair] = hit.face
    pairs.face[pair] = face
    pairs.key[pair] = t
    pairs.barycentric[pair] = barycentric
    pairs.weight[pair] = 0.5 * wp.length(cross) / wp.float32(per_face)
    if are_partners(offset, reach, n, wp.normalize(cross)):
        pairs.normal[pair] = n
        pairs.residual[pair] = wp.dot(n, offset)
    else:
        # Off the surface, such as at the tip of a needle: straight back to it.
        pairs.normal[pair] = wp.normalize(offset)
        pairs.residual[pair] = wp.length(offset)


@wp.func
def store_border_pair(
    pairs: Pairs,
    first: wp.int32,
    t: wp.int32,
    target: Surface,
    half_edge: wp.int32,
    along: wp.float32,
    offset: wp.vec3,
    weight: wp.float32,
):
    """Two pairs at a point of an output border edge: how far the input lies ahead, both ways across the edge."""
    a = target.points[t, target.corner_vertex[half_edge]]
    b = target.points[t, half_edge_target(target.corner_vertex, half_edge)]
    across = first_tangent(wp.normalize(b - a))
    barycentric = wp.vec3()
    barycentric[half_edge % 3] = 1.0 - along
    barycentric[(half_edge + 1) % 3] = along
    for side in range(2):
        n = across
        if side == 1:
            n = wp.cross(wp.normalize(b - a), across)
        i = first + side
        pairs.face[i] = half_edge / 3
        pairs.key[i] = t
        pairs.barycentric[i] = barycentric
        pairs.normal[i] = n
        pairs.residual[i] = wp.dot(n, offset)
        pairs.weight[i] = weight


@wp.kernel
def match_border_samples(
    # in
    turns: Turns,
    reach: wp.float32,
    moving: Surface,
    fixed: Surface,
    moving_is_output: wp.int32,
    half_edge_in: wp.array[wp.int32],
    start_in: wp.array[wp.int32],
    per_edge: wp.int32,
    width: wp.float32,
    first_pair: wp.int32,
    # out
    pairs: Pairs,
):
    """Pair points of border edges of one surface with the border of the other, each point in two pairs.

    A point stands for its part of the edge's length, times ``width``. ``start_in`` is a vertex of the fixed surface
    near each vertex of the moving one.
    """
    own = own_pair(turns, turns.first + wp.tid())
    sample = own / turns.count
    if sample >= half_edge_in.shape[0] * per_edge:
        return
    i = first_pair + 2 * own
    pairs.face[i] = -1
    pairs.face[i + 1] = -1
    t = turns.key
    h = half_edge_in[sample / per_edge]
    along = (wp.float32(sample % per_edge) + 0.5) / wp.float32(per_edge)
    a = moving.points[t, moving.corner_vertex[h]]
    b = moving.points[t, half_edge_target(moving.corner_vertex, h)]
    x = a + along * (b - a)
    hit = closest_border_hit(fixed, t, start_in[moving.corner_vertex[h]], x)
    if hit.half_edge < 0 or hit.squared > reach * reach:
        return
    c = fixed.points[t, fixed.corner_vertex[hit.half_edge]]
    d = fixed.points[t, half_edge_target(fixed.corner_vertex, hit.half_edge)]
    if wp.dot(wp.normalize(b - a), wp.normalize(d - c)) < SAME_SIDE:
        return
    offset = c + hit.along * (d - c) - x
    weight = width * wp.length(b - a) / wp.float32(per_edge)
    if moving_is_output == 1:
        store_border_pair(pairs, i, t, moving, h, along, offset, weight)
    else:
        store_border_pair(pairs, i, t, fixed, hit.half_edge, hit.along, -offset, weight)


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
) -> Element:
    """Add the equation of a pair, for the whole correction rather than what is still missing of it."""
    t = pairs.key[i]
    b = pairs.barycentric[i]
    n = pairs.normal[i]
    weight = scale * pairs.weight[i]
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
    weights: wp.vec3,
    mean_edge_squared: wp.float32,
    pull: Pull,
    points_in: wp.array2d[wp.vec3],
    frame_in: wp.array2d[wp.mat33],
    correction_in: wp.array[wp.vec3],
    hold_in: wp.array[wp.vec3],
    # out
    block_out: wp.array2d[wp.mat33],
    right_out: wp.array[wp.vec3],
):
    """The nine blocks and three right sides of each face; ``weights`` scale input pairs, output pairs and edges."""
    f = wp.tid()
    v = wp.vec3i(corner_vertex_in[3 * f], corner_vertex_in[3 * f + 1], corner_vertex_in[3 * f + 2])
    e = Element()
    for k in range(input_start_in[f], input_start_in[f + 1]):
        e = include_pair(e, input_pairs, input_order_in[k], weights[0], v, frame_in, correction_in)
    per_face = output_pairs.face.shape[0] / (corner_vertex_in.shape[0] / 3)
    for i in range(f * per_face, (f + 1) * per_face):
        if output_pairs.face[i] >= 0:
            e = include_pair(e, output_pairs, i, weights[1], v, frame_in, correction_in)
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
            weight = weights[2] * mean_edge_squared / (squared * squared)
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
    share = area * pull.mass / (3.0 * wp.float32(points_in.shape[0]))
    along = share * wp.vec3(pull.tangent, pull.tangent, pull.normal)
    nothing = MIN_PULL * wp.vec3(1.0, 1.0, 1.0)
    block_out[f, 0] = e.m00 + wp.diag(wp.cw_mul(along, hold_in[v[0]]) + nothing)
    block_out[f, 1] = e.m01
    block_out[f, 2] = e.m02
    block_out[f, 3] = wp.transpose(e.m01)
    block_out[f, 4] = e.m11 + wp.diag(wp.cw_mul(along, hold_in[v[1]]) + nothing)
    block_out[f, 5] = e.m12
    block_out[f, 6] = wp.transpose(e.m02)
    block_out[f, 7] = wp.transpose(e.m12)
    block_out[f, 8] = e.m22 + wp.diag(wp.cw_mul(along, hold_in[v[2]]) + nothing)
    right_out[3 * f] = e.r0
    right_out[3 * f + 1] = e.r1
    right_out[3 * f + 2] = e.r2
