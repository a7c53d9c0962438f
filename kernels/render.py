"""Pictures by ray casting: one thread per pixel, parallel rays, two lights, lines along the edges if asked for."""

import warp as wp

from warpqem.kernels.texture import NormalMaps, blended_texel, tilted_normal

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# Light from over the viewer's left shoulder, and a weaker one from the right that keeps the dark side readable.
KEY_LIGHT = wp.constant(wp.vec3(-0.476, 0.617, 0.627))
FILL_LIGHT = wp.constant(wp.vec3(0.830, 0.055, 0.555))
AMBIENT = wp.constant(wp.float32(0.24))
KEY = wp.constant(wp.float32(0.68))
FILL = wp.constant(wp.float32(0.20))
# Rays start so far before the middle, in diagonals of the mesh, and end so far behind it.
REACH = wp.constant(wp.float32(4.0))
# Half width of a line, in pixels.
LINE_HALF_WIDTH = wp.constant(wp.float32(0.6))


@wp.struct
class Camera:
    """Parallel rays: the middle of the picture, unit vectors across it and up, and the world size of a pixel."""

    middle: wp.vec3
    right: wp.vec3
    up: wp.vec3
    pixel: wp.float32
    reach: wp.float32  # length of the mesh's diagonal


@wp.struct
class Shading:
    """What a surface looks like."""

    color: wp.array[wp.vec3]  # (3N,) linear, at the corners
    normal: wp.array[wp.vec3]  # (3N,) unit, 0 for that of the face; read where ``smooth`` is 1
    smooth: wp.int32
    line: wp.float32  # how much darker a line along the edges is, 0 for none to 1 for black
    background: wp.vec3  # linear
    uv: wp.array[wp.vec2]  # (3N,), from the lower left; read where there is a texture
    face_texture: wp.array[wp.int32]  # (N,), -1 for none
    texel: wp.array[wp.vec3]  # linear, of all textures after each other, the top row first
    texture_start: wp.array[wp.int32]  # (T,) first texel
    texture_size: wp.array[wp.vec2i]  # (T,) width and height
    texture_repeats: wp.array[wp.vec2i]  # (T,) 1 where it repeats beyond its border, across and up
    maps: NormalMaps  # that tilt ``normal``


@wp.struct
class Seen:
    """What a ray meets."""

    color: wp.vec3  # linear, under the light; the background where there is nothing
    light: wp.float32  # on the surface, 0 where there is none
    covered: wp.float32  # 1 where there is a surface, else 0


@wp.func
def lighten(normal: wp.vec3, face_normal: wp.vec3, camera: Camera) -> wp.float32:
    """Light on a surface whose face is seen from either side, both sides alike."""
    toward = wp.cross(camera.right, camera.up)
    # The face says which side is seen: a normal between corners may point away from the viewer at an outline.
    if wp.dot(normal, face_normal) * wp.dot(face_normal, toward) < 0.0:
        normal = -normal
    n = wp.vec3(wp.dot(normal, camera.right), wp.dot(normal, camera.up), wp.dot(normal, toward))
    return AMBIENT + KEY * wp.max(wp.dot(n, KEY_LIGHT), 0.0) + FILL * wp.max(wp.dot(n, FILL_LIGHT), 0.0)


@wp.func
def edge_distance(a: wp.vec3, b: wp.vec3, c: wp.vec3, share: wp.vec3) -> wp.float32:
    """Distance of a point of triangle ``abc`` from the nearest edge."""
    double_area = wp.length(wp.cross(b - a, c - a))
    from_a = share[0] * double_area / wp.max(wp.length(c - b), 1.0e-30)
    from_b = share[1] * double_area / wp.max(wp.length(a - c), 1.0e-30)
    from_c = share[2] * double_area / wp.max(wp.length(b - a), 1.0e-30)
    return wp.min(from_a, wp.min(from_b, from_c))


@wp.func
def texture_color(shading: Shading, texture: wp.int32, uv: wp.vec2) -> wp.vec3:
    """The linear colour of a texture, between its four nearest texels."""
    start = shading.texture_start[texture]
    size = shading.texture_size[texture]
    repeats = shading.texture_repeats[texture]
    return blended_texel(shading.texel, start, size, repeats, uv)


@wp.func
def trace_ray(
    mesh: wp.uint64,
    corner_vertex: wp.array[wp.int32],
    points: wp.array[wp.vec3],
    camera: Camera,
    shading: Shading,
    x: wp.float32,
    y: wp.float32,
) -> Seen:
    """What is seen at ``(x, y)``, in pixels from the middle, y upwards."""
    seen = Seen()
    toward = wp.cross(camera.right, camera.up)
    start = camera.middle + camera.pixel * (x * camera.right + y * camera.up) + REACH * camera.reach * toward
    hit = wp.mesh_query_ray(mesh, start, -toward, 2.0 * REACH * camera.reach)
    if not hit.result:
        seen.color = shading.background
        return seen
    i = corner_vertex[3 * hit.face]
    j = corner_vertex[3 * hit.face + 1]
    k = corner_vertex[3 * hit.face + 2]
    share = wp.vec3(hit.u, hit.v, 1.0 - hit.u - hit.v)
    corner = 3 * hit.face
    normal = hit.normal
    if shading.smooth == 1:
        normal = (
            share[0] * shading.normal[corner]
            + share[1] * shading.normal[corner + 1]
            + share[2] * shading.normal[corner + 2]
        )
        # Of a face without some, and where they cancel out.
        if not wp.length_sq(normal) > 0.0:
            normal = hit.normal
        normal = wp.normalize(tilted_normal(shading.maps, hit.face, share, normal))
    color = (
        share[0] * shading.color[corner] + share[1] * shading.color[corner + 1] + share[2] * shading.color[corner + 2]
    )
    texture = shading.face_texture[hit.face]
    if texture >= 0:
        uv = share[0] * shading.uv[corner] + share[1] * shading.uv[corner + 1] + share[2] * shading.uv[corner + 2]
        color = wp.cw_mul(color, texture_color(shading, texture, uv))
    light = lighten(normal, hit.normal, camera)
    color = color * light
    if shading.line > 0.0:
        away = edge_distance(points[i], points[j], points[k], share) / camera.pixel
        color = color * wp.lerp(1.0 - shading.line, 1.0, wp.clamp(away / LINE_HALF_WIDTH - 0.5, 0.0, 1.0))
    seen.color = color
    seen.light = light
    seen.covered = 1.0
    return seen


@wp.func
def pixel_mean(
    mesh: wp.uint64,
    corner_vertex: wp.array[wp.int32],
    points: wp.array[wp.vec3],
    camera: Camera,
    shading: Shading,
    samples: wp.int32,
    height: wp.int32,
    width: wp.int32,
    row: wp.int32,
    column: wp.int32,
) -> Seen:
    """The mean of what ``samples`` x ``samples`` rays of a pixel see."""
    mean = Seen()
    for i in range(samples):
        x = wp.float32(column) + (wp.float32(i) + 0.5) / wp.float32(samples) - 0.5 * wp.float32(width)
        for j in range(samples):
            y = 0.5 * wp.float32(height) - wp.float32(row) - (wp.float32(j) + 0.5) / wp.float32(samples)
            seen = trace_ray(mesh, corner_vertex, points, camera, shading, x, y)
            mean.color += seen.color
            mean.light += seen.light
            mean.covered += seen.covered
    count = wp.float32(samples * samples)
    mean.color = mean.color / count
    mean.light = mean.light / count
    mean.covered = mean.covered / count
    return mean


@wp.kernel
def render_pixels(
    # in
    mesh: wp.uint64,
    corner_vertex_in: wp.array[wp.int32],
    points_in: wp.array[wp.vec3],
    camera: Camera,
    shading: Shading,
    samples: wp.int32,
    # out
    image_out: wp.array2d[wp.vec3],
):
    """Linear colours (height, width), each the mean of ``samples`` x ``samples`` rays."""
    row, column = wp.tid()
    height = image_out.shape[0]
    width = image_out.shape[1]
    mean = pixel_mean(mesh, corner_vertex_in, points_in, camera, shading, samples, height, width, row, column)
    image_out[row, column] = mean.color


@wp.kernel
def render_layers(
    # in
    mesh: wp.uint64,
    corner_vertex_in: wp.array[wp.int32],
    points_in: wp.array[wp.vec3],
    camera: Camera,
    shading: Shading,
    samples: wp.int32,
    # out
    image_out: wp.array2d[wp.vec3],
    light_out: wp.array2d[wp.float32],
    covered_out: wp.array2d[wp.float32],
):
    """The same, and besides the mean light on what is seen and the part of each pixel that the surface covers."""
    row, column = wp.tid()
    height = image_out.shape[0]
    width = image_out.shape[1]
    mean = pixel_mean(mesh, corner_vertex_in, points_in, camera, shading, samples, height, width, row, column)
    image_out[row, column] = mean.color
    light_out[row, column] = mean.light
    covered_out[row, column] = mean.covered
