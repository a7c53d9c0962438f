"""Pairs of nearest points between the input and the output surface, both ways, in one key frame.

A pair of a point of the output, with barycentric weights in one face, and a point of the input has a normal and a
residual: how far the input lies ahead along the normal (point-to-plane). :mod:`.refit` makes equations of them.
"""

import warp as wp

from warpqem.kernels.material_frame import first_tangent
from warpqem.kernels.prefetch import prefetch, prefetch_item
from warpqem.kernels.surface_walk import (
    Surface,
    closest_hit,
    closest_line_hit,
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

# What is across the surface counts so much at a seam of what is along it: the surfaces are paired there already, and a
# seam's chord inside a bend draws its ends outwards. Without any, pictures lose 0.2 dB at outlines with seams on them.
SEAM_LIFT = wp.constant(wp.float32(0.5))

# How many samples of a frame ahead of its use each link of the chain is asked for.
PAIRS_AHEAD = wp.constant(wp.int32(24))
FACES_AHEAD = wp.constant(wp.int32(12))
POINTS_AHEAD = wp.constant(wp.int32(4))


@wp.struct
class Pairs:
    """Pairs of points: the output face and frame, weights in the face, normal, residual, weight, where to walk from.

    ``squared`` is how far a sample is from where its walk ended, partner or not; zero where it ended nowhere. The
    nearest point may be on another side.
    """

    face: wp.array[wp.int32]  # -1: no pair
    key: wp.array[wp.int32]
    barycentric: wp.array[wp.vec3]
    normal: wp.array[wp.vec3]
    residual: wp.array[wp.float32]
    weight: wp.array[wp.float32]
    near: wp.array[wp.int32]  # face where the walk before ended, -1 before the first
    squared: wp.array[wp.float32]


@wp.struct
class Turns:
    """Which pairs a launch finds: those of some key frames. Samples take turns, so that all frames are met."""

    first: wp.int32  # of the launch's part of the frames' pairs
    count: wp.int32  # pairs of each sample
    key: wp.int32  # the first of the frames
    key_count: wp.int32
    per_key: wp.int32  # pairs that a frame may have
    prefetches: wp.int32  # 1 where a thread takes them one after another


@wp.func
def own_key(turns: Turns, i: wp.int32) -> wp.int32:
    """The frame of pair number ``i`` of the launch's part."""
    return turns.key + (turns.first + i) / turns.per_key


@wp.func
def own_pair(turns: Turns, key: wp.int32, i: wp.int32) -> wp.int32:
    """Pair number ``i`` of the launch's part: turn ``k`` of sample ``s`` is in frame ``s + k (key_count / count)``.

    Frames are counted cyclically.
    """
    place = (turns.first + i) % turns.per_key
    turn = place % turns.count
    first_sample = (key + turns.key_count - turn * (turns.key_count / turns.count)) % turns.key_count
    return (first_sample + (place / turns.count) * turns.key_count) * turns.count + turn


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


@wp.func
def prefetch_face_points(s: Surface, t: wp.int32, face: wp.int32):
    """The corners of a face in frame ``t``."""
    for k in range(3):
        prefetch_item(s.points, t, s.corner_vertex[3 * face + k])


@wp.func
def prefetch_partners(turns: Turns, pairs: Pairs, other: Surface, t: wp.int32, pair: wp.int32):
    """What samples that come after one need of the surface that they were near to."""
    if turns.prefetches == 0:
        return
    stride = turns.key_count * turns.count
    later = pair + PAIRS_AHEAD * stride
    if later < pairs.near.shape[0]:
        prefetch(pairs.near, later)
    later = pair + FACES_AHEAD * stride
    if later < pairs.near.shape[0]:
        near = pairs.near[later]
        if near >= 0:
            prefetch(other.corner_vertex, 3 * near)
    later = pair + POINTS_AHEAD * stride
    if later < pairs.near.shape[0]:
        near = pairs.near[later]
        if near >= 0:
            prefetch_face_points(other, t, near)


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
    t = own_key(turns, wp.tid())
    pair = own_pair(turns, t, wp.tid())
    if pair >= pairs.face.shape[0]:
        return
    sample = pair / turns.count
    face_count = source.corner_vertex.shape[0] / 3
    prefetch_partners(turns, pairs, target, t, pair)
    later = sample + FACES_AHEAD * turns.key_count
    if turns.prefetches == 1 and later < face_count:
        prefetch_face_points(source, t, later)
    if sample >= face_count + source.adjacency_start.shape[0] - 1:
        return
    pairs.face[pair] = -1
    pairs.squared[pair] = 0.0
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
    pairs.squared[pair] = wp.length_sq(offset)
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
    t = own_key(turns, wp.tid())
    pair = own_pair(turns, t, wp.tid())
    if pair >= pairs.face.shape[0]:
        return
    sample = pair / turns.count
    prefetch_partners(turns, pairs, source, t, pair)
    per_face = barycentric_in.shape[0]
    face = sample / per_face
    barycentric = barycentric_in[sample % per_face]
    x = surface_point(target, t, face, barycentric)
    start = start_in[target.corner_vertex[3 * face + nearest_corner(barycentric)]]
    hit = closest_hit(source, t, wp.vec3i(start, -1, -1), pairs.near[pair], x)
    pairs.face[pair] = -1
    pairs.squared[pair] = 0.0
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
    pairs.squared[pair] = wp.length_sq(offset)
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


@wp.kernel
def measure_vertex_distances(
    # in
    first_output: wp.int32,
    t: wp.int32,
    source: Surface,
    target: Surface,
    start_in: wp.array[wp.int32],
    # in and out
    near: wp.array2d[wp.int32],
    # out
    squared_out: wp.array2d[wp.float32],
):
    """How far each output vertex is in a key frame from where a walk to the input ends, squared, and at which face.

    Of (K, C) arrays row ``t`` is written; zero and face -1 for nowhere. A walk begins where that of the frame before
    ended. A vertex that sticks out is further away than any sample of its faces.
    """
    v = first_output + wp.tid()
    x = target.points[t, v]
    face = wp.int32(-1)
    if t > 0:
        face = near[t - 1, v]
    hit = closest_hit(source, t, wp.vec3i(start_in[v], -1, -1), face, x)
    squared = wp.float32(0.0)
    if hit.face >= 0:
        squared = wp.length_sq(surface_point(source, t, hit.face, hit.barycentric) - x)
    near[t, v] = hit.face
    squared_out[t, v] = squared


@wp.func
def edge_normal(s: Surface, t: wp.int32, half_edge: wp.int32) -> wp.vec3:
    """The mean of the normals of the faces at an edge, of length one; 0 where they have none."""
    normal = wp.normalize(face_cross(s, t, half_edge / 3))
    if s.opposite[half_edge] >= 0:
        normal += wp.normalize(face_cross(s, t, s.opposite[half_edge] / 3))
    return wp.normalize(normal)


@wp.func
def store_line_pair(
    pairs: Pairs,
    first: wp.int32,
    t: wp.int32,
    target: Surface,
    half_edge: wp.int32,
    along: wp.float32,
    offset: wp.vec3,
    weight: wp.float32,
    on_seams: wp.int32,
):
    """Two pairs at a point of an output edge of a border or seam: how far the input is ahead, both ways across it.

    At a seam the first is along the surface, the other counts less.
    """
    a = target.points[t, target.corner_vertex[half_edge]]
    b = target.points[t, half_edge_target(target.corner_vertex, half_edge)]
    across = first_tangent(wp.normalize(b - a))
    second_weight = weight
    if on_seams == 1:
        second_weight = SEAM_LIFT * weight
        aside = wp.cross(wp.normalize(b - a), edge_normal(target, t, half_edge))
        # A sliver has no normal.
        if wp.length_sq(aside) > 0.5:
            across = aside
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
        pairs.weight[i] = wp.where(side == 1, second_weight, weight)


@wp.kernel
def match_line_samples(
    # in
    turns: Turns,
    reach: wp.float32,
    moving: Surface,
    fixed: Surface,
    moving_is_output: wp.int32,
    on_seams: wp.int32,
    half_edge_in: wp.array[wp.int32],
    start_in: wp.array[wp.int32],
    per_edge: wp.int32,
    width_in: wp.array[wp.float32],
    width_index: wp.int32,
    first_pair: wp.int32,
    # out
    pairs: Pairs,
):
    """Pair points of border edges of one surface with the border of the other, each point in two pairs.

    Where ``on_seams`` is 1, of seam edges with seams, which run either way. A point stands for its part of the edge's
    length, times a width of ``width_in``. ``start_in`` is a vertex of the fixed surface near each vertex of the moving
    one.
    """
    t = own_key(turns, wp.tid())
    own = own_pair(turns, t, wp.tid())
    sample = own / turns.count
    if sample >= half_edge_in.shape[0] * per_edge:
        return
    i = first_pair + 2 * own
    pairs.face[i] = -1
    pairs.face[i + 1] = -1
    h = half_edge_in[sample / per_edge]
    along = (wp.float32(sample % per_edge) + 0.5) / wp.float32(per_edge)
    a = moving.points[t, moving.corner_vertex[h]]
    b = moving.points[t, half_edge_target(moving.corner_vertex, h)]
    x = a + along * (b - a)
    hit = closest_line_hit(fixed, on_seams, t, start_in[moving.corner_vertex[h]], x)
    if hit.half_edge < 0 or hit.squared > reach * reach:
        return
    c = fixed.points[t, fixed.corner_vertex[hit.half_edge]]
    d = fixed.points[t, half_edge_target(fixed.corner_vertex, hit.half_edge)]
    along_both = wp.dot(wp.normalize(b - a), wp.normalize(d - c))
    if on_seams == 1:
        along_both = wp.abs(along_both)
    if along_both < SAME_SIDE:
        return
    offset = c + hit.along * (d - c) - x
    weight = width_in[width_index] * wp.length(b - a) / wp.float32(per_edge)
    if moving_is_output == 1:
        store_line_pair(pairs, i, t, moving, h, along, offset, weight, on_seams)
    else:
        store_line_pair(pairs, i, t, fixed, hit.half_edge, hit.along, -offset, weight, on_seams)
