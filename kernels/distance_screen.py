"""How far patches of a moving mesh are from faces of another one at most, in many frames side by side.

The distance to one face is convex: no point of a patch is further from the face than the furthest of its corners, in
any frame, whatever both meshes do. See :mod:`warpqem.kernels.lanes` for the layout.
"""

from typing import Any

import warp as wp

from warpqem.kernels.lanes import POINTS_ARRAY, lane_dot, lane_kernel, lane_scale

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# Faces that a patch is compared with. It is near one in most frames, and in a fold near another one in some.
SCREEN_HINTS = wp.constant(wp.int32(2))


@wp.struct
class ScreenPatches:
    """Parts of the faces of a mesh."""

    face: wp.array[wp.int32]  # (P,)
    place: wp.array2d[wp.float32]  # (P, 6), barycentric coordinates of corners 1 and 2 of the face, at three corners
    hint: wp.array2d[wp.int32]  # (P, SCREEN_HINTS), faces of the other mesh; -1 for none


@wp.func
def lane_ratio(a: Any, b: Any):
    """``a / b`` in each lane, within 0 and 1; 0 where b is not positive."""
    c = type(a)()
    for k in range(len(a)):
        c[k] = wp.where(b[k] > 0.0, wp.clamp(a[k] / b[k], 0.0, 1.0), 0.0)
    return c


@wp.func
def lane_least(a: Any, b: Any):
    """The smaller one in each lane."""
    c = type(a)()
    for k in range(len(a)):
        c[k] = wp.min(a[k], b[k])
    return c


@wp.func
def lane_most(a: Any, b: Any):
    """The larger one in each lane."""
    c = type(a)()
    for k in range(len(a)):
        c[k] = wp.max(a[k], b[k])
    return c


@wp.func
def lane_squared(r: Any, ab: Any, ac: Any, aa: Any, mixed: Any, cc: Any):
    """Squared distances (width,) of points from the triangle 0, ab, ac, whose edges have these dot products.

    The least of the nearest point of each edge, and of the foot of the perpendicular, moved into the triangle. In
    obtuse triangles this may be more than the distance by rounding only: where the foot is outside, an edge is nearest.
    """
    p = lane_dot(r, ab)
    q = lane_dot(r, ac)
    foot = type(p)()
    beside = type(p)()
    for k in range(len(p)):
        area = aa[k] * cc[k] - mixed[k] * mixed[k]
        inverse = wp.where(area > 0.0, 1.0 / area, 0.0)
        foot[k] = wp.clamp((cc[k] * p[k] - mixed[k] * q[k]) * inverse, 0.0, 1.0)
        beside[k] = wp.clamp((aa[k] * q[k] - mixed[k] * p[k]) * inverse, 0.0, 1.0 - foot[k])
    apart = r - lane_scale(foot, ab) - lane_scale(beside, ac)
    least = lane_dot(apart, apart)
    apart = r - lane_scale(lane_ratio(p, aa), ab)
    least = lane_least(least, lane_dot(apart, apart))
    apart = r - lane_scale(lane_ratio(q, cc), ac)
    least = lane_least(least, lane_dot(apart, apart))
    # From b to c: the dot products follow from those of the other edges.
    bc = ac - ab
    from_b = r - ab
    apart = from_b - lane_scale(lane_ratio(lane_dot(from_b, bc), aa - mixed - mixed + cc), bc)
    return lane_least(least, lane_dot(apart, apart))


@lane_kernel(own=POINTS_ARRAY, other=POINTS_ARRAY)
def bound_patches(
    # in
    own: Any,
    other: Any,
    own_corner: wp.array[wp.int32],
    other_corner: wp.array[wp.int32],
    patches: ScreenPatches,
    enough: wp.float32,
    first_patch: wp.int32,
    # out
    bound_out: wp.array2d[wp.float32],
):
    """The largest distance of a corner from the face that is best for the patch, (P, F).

    Frames that fill up the blocks are included. ``own`` (V, B) and ``other`` (W, B) are points of both meshes, the
    corners (3N,) vertices. Where the first face is near enough in all frames of a block, the second one is left out.
    Without a face it is 0.
    """
    tid, b = wp.tid()
    i = first_patch + tid
    face = patches.face[i]
    a = own[own_corner[3 * face], b]
    ab = own[own_corner[3 * face + 1], b] - a
    ac = own[own_corner[3 * face + 2], b] - a
    width = len(a[0])
    best = a[0] - a[0]
    largest = wp.float32(0.0)
    for h in range(SCREEN_HINTS):
        near = patches.hint[i, h]
        if near >= 0 and (h == 0 or largest > enough * enough):
            d = other[other_corner[3 * near], b]
            de = other[other_corner[3 * near + 1], b] - d
            df = other[other_corner[3 * near + 2], b] - d
            ee = lane_dot(de, de)
            ef = lane_dot(de, df)
            ff = lane_dot(df, df)
            apart = a - d
            furthest = ee - ee
            for k in range(3):
                r = apart + patches.place[i, 2 * k] * ab + patches.place[i, 2 * k + 1] * ac
                furthest = lane_most(furthest, lane_squared(r, de, df, ee, ef, ff))
            if h == 0:
                best = furthest
                for lane in range(width):
                    largest = wp.max(largest, best[lane])
            else:
                best = lane_least(best, furthest)
    for lane in range(width):
        bound_out[i, b * width + lane] = wp.sqrt(best[lane])


# Loops over corners and faces stay loops: unrolled, they take several times as long to compile and run no faster.
for _kernel in bound_patches.values():
    wp.set_module_options({"max_unroll": 1}, _kernel.module)
del _kernel
