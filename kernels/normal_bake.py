"""Normal maps baked: texels of the output's texture square, rays from there to the input, margins around islands.

Lengths are parts of the input's diagonal.
"""

import warp as wp

from warpqem.kernels.closest_point import closest_barycentric
from warpqem.kernels.texture import NormalMaps, tangent_frame, tilted_normal

# No gradients are taken. Loops stay loops: unrolled, they take several times as long to compile and run no faster.
wp.set_module_options({"enable_backward": False, "max_unroll": 1})

# Two points of single precision nearer than this are one. Rays begin so far behind their point, as the input may pass
# just through it, and go on so far behind a face that is not the one.
STEP = wp.constant(wp.float32(1.0e-6))
# Faces of the wrong side or part that a ray passes at most: more layers than clothes have.
MAX_LAYERS = wp.constant(wp.int32(16))
# A ray that meets the input so many times further away than its nearest point lies passes along it, not through it.
MAX_STRETCH = wp.constant(wp.float32(4.0))
# Everything is nearer than this.
FAR = wp.constant(wp.float32(1.0e6))
# Rounding in the square of the texture: a point so little outside of a triangle is on its edge, and one that is this
# far inside of two is on both.
ON_EDGE = wp.constant(wp.float32(1.0e-5))
INSIDE = wp.constant(wp.float32(1.0e-3))
# Boxes about texture coordinates reach a little beyond them, as those of the hierarchy are rounded.
UV_MARGIN = wp.constant(wp.float32(1.0e-6))
# A frame whose three axes span less than this has none.
FLAT_FRAME = wp.constant(wp.float32(1.0e-8))


@wp.struct
class Output:
    """The mesh that gets the map, N' faces."""

    uv_mesh: wp.uint64  # its triangles in the plane of texture coordinates
    uv: wp.array[wp.vec2]  # (3N',)
    position: wp.array[wp.vec3]  # (3N',)
    normal: wp.array[wp.vec3]  # (3N',) unit
    tangent: wp.array[wp.vec4]  # (3N',)
    part: wp.array[wp.int32]  # (N',) which part of the input each face is of


@wp.struct
class Input:
    """The mesh that the normals are of, N faces."""

    mesh: wp.uint64  # corner 3 f + k is its point
    position: wp.array[wp.vec3]  # (3N,)
    normal: wp.array[wp.vec3]  # (3N,) unit
    part: wp.array[wp.int32]  # (N,)
    maps: NormalMaps


@wp.struct
class Place:
    """A point of a face, -1 for none; ``distance`` is how far it is."""

    face: wp.int32
    share: wp.vec3
    distance: wp.float32


@wp.func
def blended(values: wp.array[wp.vec3], face: wp.int32, share: wp.vec3) -> wp.vec3:
    """A value at a point of a face."""
    return share[0] * values[3 * face] + share[1] * values[3 * face + 1] + share[2] * values[3 * face + 2]


@wp.func
def uv_share(a: wp.vec2, b: wp.vec2, c: wp.vec2, p: wp.vec2) -> wp.vec3:
    """Barycentric coordinates of a point of the plane; negative all three in a triangle without area."""
    whole = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    if whole == 0.0:
        return wp.vec3(-1.0, -1.0, -1.0)
    second = ((p[0] - a[0]) * (c[1] - a[1]) - (p[1] - a[1]) * (c[0] - a[0])) / whole
    third = ((b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])) / whole
    return wp.vec3(1.0 - second - third, second, third)


@wp.func
def face_at(output: Output, p: wp.vec2) -> Place:
    """The face of the output that texture coordinates are on: of several the one that they are deepest in."""
    best = Place()
    best.face = -1
    deepest = -ON_EDGE
    low = wp.vec3(p[0] - UV_MARGIN, p[1] - UV_MARGIN, -1.0)
    high = wp.vec3(p[0] + UV_MARGIN, p[1] + UV_MARGIN, 1.0)
    query = wp.mesh_query_aabb(output.uv_mesh, low, high)
    face = wp.int32(0)
    while wp.mesh_query_next(query, face):
        share = uv_share(output.uv[3 * face], output.uv[3 * face + 1], output.uv[3 * face + 2], p)
        depth = wp.min(share)
        if depth > deepest or (depth == deepest and face < best.face):
            deepest = depth
            best.face = face
            best.share = share
    return best


@wp.func
def is_wanted(source: Input, face: wp.int32, normal: wp.vec3, part: wp.int32) -> wp.bool:
    """Whether a face of the input is of the part, and faces the side that the normal does."""
    if source.part[face] != part:
        return False
    a = source.position[3 * face]
    return wp.dot(wp.cross(source.position[3 * face + 1] - a, source.position[3 * face + 2] - a), normal) > 0.0


@wp.func
def cast(source: Input, p: wp.vec3, direction: wp.vec3, normal: wp.vec3, part: wp.int32, reach: wp.float32) -> Place:
    """The first face that is wanted on a ray."""
    found = Place()
    found.face = -1
    travelled = -STEP
    for _ in range(MAX_LAYERS):
        hit = wp.mesh_query_ray(source.mesh, p + travelled * direction, direction, reach - travelled)
        if not hit.result:
            return found
        travelled += hit.t
        if is_wanted(source, hit.face, normal, part):
            found.face = hit.face
            found.share = wp.vec3(hit.u, hit.v, 1.0 - hit.u - hit.v)
            found.distance = wp.abs(travelled)
            return found
        travelled += STEP
    return found


@wp.func
def nearest_within(source: Input, p: wp.vec3, normal: wp.vec3, part: wp.int32, radius: wp.float32) -> Place:
    """The nearest point of the wanted faces, no further than ``radius``; of equally near ones on the first face."""
    best = Place()
    best.face = -1
    best.distance = radius
    extent = wp.vec3(radius, radius, radius)
    query = wp.mesh_query_aabb(source.mesh, p - extent, p + extent)
    face = wp.int32(0)
    while wp.mesh_query_next(query, face):
        if is_wanted(source, face, normal, part):
            a = source.position[3 * face]
            b = source.position[3 * face + 1]
            c = source.position[3 * face + 2]
            share = closest_barycentric(p, a, b, c)
            distance = wp.length(share[0] * a + share[1] * b + share[2] * c - p)
            if distance < best.distance or (distance == best.distance and (best.face < 0 or face < best.face)):
                best.face = face
                best.share = share
                best.distance = distance
    return best


@wp.func
def find_source(source: Input, p: wp.vec3, normal: wp.vec3, part: wp.int32) -> Place:
    """The point of the input that a point of the output stands for: along its normal, or else the nearest one."""
    found = cast(source, p, normal, normal, part, 1.0)
    reach = wp.float32(1.0)
    if found.face >= 0:
        reach = found.distance
    inwards = cast(source, p, -normal, normal, part, reach)
    if inwards.face >= 0 and (found.face < 0 or inwards.distance < found.distance):
        found = inwards
    radius = wp.float32(STEP)
    if found.face >= 0:
        radius = found.distance / MAX_STRETCH
        # Nothing at all so near, as nearly everywhere: found at once.
        near = wp.mesh_query_point_no_sign(source.mesh, p, radius)
        if not near.result:
            return found
        nearest = nearest_within(source, p, normal, part, radius)
        if nearest.face >= 0:
            return nearest
        return found
    # A box that begins where the nearest face of all is, and grows until it holds a wanted one, or all of them.
    near = wp.mesh_query_point_no_sign(source.mesh, p, FAR)
    at = wp.mesh_eval_position(source.mesh, near.face, near.u, near.v)
    radius = wp.max(radius, (1.0 + ON_EDGE) * wp.length(at - p))
    most = 2.0 * (radius + 1.0)
    while radius < most:
        found = nearest_within(source, p, normal, part, radius)
        if found.face >= 0:
            return found
        radius *= 2.0
    return found


@wp.func
def baked_normal(output: Output, source: Input, at: Place) -> wp.vec3:
    """The input's normal in the tangent frame of the output, of length one."""
    normal = blended(output.normal, at.face, at.share)
    direction = wp.normalize(normal)
    if wp.length_sq(direction) == 0.0:
        return wp.vec3(0.0, 0.0, 1.0)
    p = blended(output.position, at.face, at.share)
    found = find_source(source, p, direction, output.part[at.face])
    if found.face < 0:
        return wp.vec3(0.0, 0.0, 1.0)
    wanted = tilted_normal(source.maps, found.face, found.share, blended(source.normal, found.face, found.share))
    frame = tangent_frame(output.tangent, at.face, at.share, normal)
    if wp.length_sq(wanted) == 0.0 or wp.abs(wp.determinant(frame)) < FLAT_FRAME:
        return wp.vec3(0.0, 0.0, 1.0)
    return wp.normalize(wp.inverse(frame) * wp.normalize(wanted))


@wp.func
def texel_point(
    row: wp.int32, column: wp.int32, i: wp.int32, j: wp.int32, samples: wp.int32, size: wp.int32
) -> wp.vec2:
    """Texture coordinates of sample (i, j) of a texel; row 0 is at the top, where the second coordinate is 1."""
    x = (wp.float32(column) + (wp.float32(i) + 0.5) / wp.float32(samples)) / wp.float32(size)
    y = (wp.float32(row) + (wp.float32(j) + 0.5) / wp.float32(samples)) / wp.float32(size)
    return wp.vec2(x, 1.0 - y)


@wp.kernel
def bake_texels(
    # in
    first_row: wp.int32,
    output: Output,
    source: Input,
    samples: wp.int32,
    # out
    normal_out: wp.array2d[wp.vec3],
    filled_out: wp.array2d[wp.int32],
):
    """Unit normals (size, size) in tangent space, each the mean of ``samples`` x ``samples`` points.

    They are 0, and so is ``filled_out``, where there is no face; that is 1 elsewhere.
    """
    i, column = wp.tid()
    row = first_row + i
    total = wp.vec3()
    for k in range(samples):
        for m in range(samples):
            at = face_at(output, texel_point(row, column, k, m, samples, normal_out.shape[1]))
            if at.face >= 0:
                total += baked_normal(output, source, at)
    normal_out[row, column] = wp.normalize(total)
    filled_out[row, column] = wp.where(wp.length_sq(total) > 0.0, 1, 0)


@wp.kernel
def count_faces_at_texels(
    # in
    first_row: wp.int32,
    output: Output,
    # out
    count_out: wp.array2d[wp.int32],
):
    """How many faces the middle of each texel (size, size) is inside of."""
    i, column = wp.tid()
    row = first_row + i
    p = texel_point(row, column, 0, 0, 1, count_out.shape[1])
    count = wp.int32(0)
    query = wp.mesh_query_aabb(output.uv_mesh, wp.vec3(p[0], p[1], -1.0), wp.vec3(p[0], p[1], 1.0))
    face = wp.int32(0)
    while wp.mesh_query_next(query, face):
        if wp.min(uv_share(output.uv[3 * face], output.uv[3 * face + 1], output.uv[3 * face + 2], p)) > INSIDE:
            count += 1
    count_out[row, column] = count


@wp.kernel
def dilate(
    # in
    first_row: wp.int32,
    normal_in: wp.array2d[wp.vec3],
    filled_in: wp.array2d[wp.int32],
    # out
    normal_out: wp.array2d[wp.vec3],
    filled_out: wp.array2d[wp.int32],
):
    """Give texels beside filled ones the mean of those, of length one; filled ones stay."""
    i, column = wp.tid()
    row = first_row + i
    normal_out[row, column] = normal_in[row, column]
    filled_out[row, column] = filled_in[row, column]
    if filled_in[row, column] == 1:
        return
    total = wp.vec3()
    for y in range(wp.max(row - 1, 0), wp.min(row + 2, normal_in.shape[0])):
        for x in range(wp.max(column - 1, 0), wp.min(column + 2, normal_in.shape[1])):
            if filled_in[y, x] == 1:
                total += normal_in[y, x]
    if wp.length_sq(total) > 0.0:
        normal_out[row, column] = wp.normalize(total)
        filled_out[row, column] = 1
