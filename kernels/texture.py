"""Images on surfaces, blended between their texels, and normals that tangent-space normal maps tilt."""

import warp as wp

wp.set_module_options({"enable_backward": False})  # no gradients are taken


@wp.struct
class NormalMaps:
    """Tangent-space normal maps on a mesh of N faces."""

    face_map: wp.array[wp.int32]  # (N,) which of T maps, -1 for none
    tangent: wp.array[wp.vec4]  # (3N,) at the corners, and 1 or -1 for the side of the bitangent
    uv: wp.array[wp.vec2]  # (3N,), from the lower left
    texel: wp.array[wp.vec3]  # vectors in tangent space, of all maps after each other, the top row first
    start: wp.array[wp.int32]  # (T,) first texel
    size: wp.array[wp.vec2i]  # (T,) width and height
    repeats: wp.array[wp.vec2i]  # (T,) 1 where it repeats beyond its border, across and up


@wp.func
def texel_place(place: wp.int32, size: wp.int32, repeats: wp.int32) -> wp.int32:
    """The texel that stands for a place beyond the border."""
    if repeats == 1:
        return (place % size + size) % size
    return wp.clamp(place, 0, size - 1)


@wp.func
def blended_texel(texel: wp.array[wp.vec3], start: wp.int32, size: wp.vec2i, repeats: wp.vec2i, uv: wp.vec2) -> wp.vec3:
    """The value of an image between its four nearest texels."""
    x = uv[0] * wp.float32(size[0]) - 0.5
    y = (1.0 - uv[1]) * wp.float32(size[1]) - 0.5
    column = wp.int32(wp.floor(x))
    row = wp.int32(wp.floor(y))
    across = x - wp.floor(x)
    down = y - wp.floor(y)
    left = texel_place(column, size[0], repeats[0])
    right = texel_place(column + 1, size[0], repeats[0])
    top = start + texel_place(row, size[1], repeats[1]) * size[0]
    bottom = start + texel_place(row + 1, size[1], repeats[1]) * size[0]
    upper = wp.lerp(texel[top + left], texel[top + right], across)
    lower = wp.lerp(texel[bottom + left], texel[bottom + right], across)
    return wp.lerp(upper, lower, down)


@wp.func
def blended_tangent(tangent: wp.array[wp.vec4], face: wp.int32, share: wp.vec3) -> wp.vec3:
    """The tangent at a point of a face, not of length one."""
    t = share[0] * tangent[3 * face] + share[1] * tangent[3 * face + 1] + share[2] * tangent[3 * face + 2]
    return wp.vec3(t[0], t[1], t[2])


@wp.func
def tangent_frame(tangent: wp.array[wp.vec4], face: wp.int32, share: wp.vec3, normal: wp.vec3) -> wp.mat33:
    """Tangent, bitangent and normal as columns: blended, and neither of length one nor upright, as of MikkTSpace."""
    t = blended_tangent(tangent, face, share)
    b = tangent[3 * face][3] * wp.cross(normal, t)
    return wp.matrix_from_cols(t, b, normal)


@wp.func
def tilted_normal(maps: NormalMaps, face: wp.int32, share: wp.vec3, normal: wp.vec3) -> wp.vec3:
    """The normal, blended between corners and of any length, as the map of a face tilts it; of any length, too."""
    index = maps.face_map[face]
    if index < 0:
        return normal
    uv = share[0] * maps.uv[3 * face] + share[1] * maps.uv[3 * face + 1] + share[2] * maps.uv[3 * face + 2]
    m = blended_texel(maps.texel, maps.start[index], maps.size[index], maps.repeats[index], uv)
    found = tangent_frame(maps.tangent, face, share, normal) * m
    # A map says nothing where it is 0, or the frame has no tangent.
    if wp.length_sq(found) > 0.0:
        return found
    return normal
