"""Frames in lanes: how positions and quadrics of many frames lie in memory.

A block holds ``width`` frames side by side, component by component: points as a (3, width) matrix, a quadric as (10,
width). On a CPU, eight frames fill a vector register, and the compiler turns each row operation into one instruction;
on a GPU a lane is a thread of its own, so there the width is one. Frames that fill up the last block are all zeros:
without area and without planes they add nothing anywhere.

Arrays are ``(V, B)`` of blocks, ``B = ceil(F / width)``, so a vertex's trajectory is contiguous.
"""

from collections.abc import Callable
from typing import Any

import warp as wp

# Rows become vector instructions only while their loops over the lanes are still loops: once unrolled, early, they are
# scalars that the compiler does not put together again (an edge's cost takes three times as long). The inline
# threshold is Warp's own, which these flags replace. For modules with arithmetic on lanes.
LANE_OPTIONS = {
    "enable_backward": False,  # no gradients are taken
    "cpu_compiler_flags": "-march=native -mllvm=-inline-threshold=9000 -mllvm=-unroll-full-max-count=4",
}
wp.set_module_options({"enable_backward": False})  # no gradients are taken

WIDE = 8  # floats in a 256-bit register
WIDTHS = (1, WIDE)
# Vertices that are packed block after block of frames: a cache then reads along the rows of so many frames as a block
# has, not of all of them (a clip of 48 frames takes 0.9 ms instead of 2.3), and what it writes stays within 2^15 bytes
# for each hundred frames.
TILE_VERTICES = 64
TILE = wp.constant(wp.int32(TILE_VERTICES))

POINTS = {width: wp.types.matrix(shape=(3, width), dtype=wp.float32) for width in WIDTHS}
QUADRIC = {width: wp.types.matrix(shape=(10, width), dtype=wp.float32) for width in WIDTHS}


def lane_kernel(**arguments: dict[int, Any]) -> Callable[[Callable], dict[int, wp.Kernel]]:
    """Make a generic function a kernel for blocks of each width; ``arguments`` gives the types that differ by width.

    The name of the function then stands for its kernels by width. Each width has a Warp module of its own: a device
    compiles the width it works with and no other, which on a GPU saves minutes.
    """

    def specialise(function: Callable) -> dict[int, wp.Kernel]:
        kernels = {}
        for width in WIDTHS:
            module = wp.get_module(f"{function.__module__}.width_{width}")
            wp.set_module_options(LANE_OPTIONS, module)
            generic = wp.kernel(function, module=module)
            kernels[width] = wp.overload(generic, {name: types[width] for name, types in arguments.items()})
        return kernels

    return specialise


def width_of(blocks: Any) -> int:
    """Frames in each block of an array of points or quadrics."""
    return blocks.dtype._shape_[1]


POINTS_ARRAY = {width: wp.array2d(dtype=POINTS[width]) for width in WIDTHS}
QUADRIC_ARRAY = {width: wp.array2d(dtype=QUADRIC[width]) for width in WIDTHS}


@wp.func
def lane_dot(a: Any, b: Any):
    """Dot products (width,) of points (3, width)."""
    return wp.cw_mul(a[0], b[0]) + wp.cw_mul(a[1], b[1]) + wp.cw_mul(a[2], b[2])


@wp.func
def lane_cross(a: Any, b: Any):
    """Cross products (3, width)."""
    c = type(a)()
    c[0] = wp.cw_mul(a[1], b[2]) - wp.cw_mul(a[2], b[1])
    c[1] = wp.cw_mul(a[2], b[0]) - wp.cw_mul(a[0], b[2])
    c[2] = wp.cw_mul(a[0], b[1]) - wp.cw_mul(a[1], b[0])
    return c


@wp.func
def lane_scale(s: Any, a: Any):
    """Points (3, width), each times its factor (width,)."""
    c = type(a)()
    c[0] = wp.cw_mul(s, a[0])
    c[1] = wp.cw_mul(s, a[1])
    c[2] = wp.cw_mul(s, a[2])
    return c


@wp.func
def lane_sum(x: Any) -> wp.float32:
    """Sum over the lanes, first to last."""
    total = wp.float32(0.0)
    for k in range(len(x)):
        total += x[k]
    return total


@wp.func
def lane_inverse_length(a: Any):
    """``1 / |a|`` (width,), 0 where the length is 0."""
    s = lane_dot(a, a)
    for k in range(len(s)):
        s[k] = wp.where(s[k] > 0.0, 1.0 / wp.sqrt(s[k]), 0.0)
    return s


@wp.func
def lane_max(x: Any, least: wp.float32):
    """The larger of each lane and ``least``."""
    y = type(x)()
    for k in range(len(x)):
        y[k] = wp.max(x[k], least)
    return y


@lane_kernel(blocks_out=POINTS_ARRAY)
def pack_frames(
    # in
    points_in: wp.array2d[wp.vec3],
    row_in: wp.array[wp.int32],
    origin: wp.vec3,
    scale: wp.float32,
    first_tile: wp.int32,
    # out
    blocks_out: Any,
):
    """Blocks (V, B) of ``(p - origin) scale`` of points (F, V): of the frames ``row_in``, or all where it is empty.

    A thread for each tile of vertices from ``first_tile`` on, block, and vertex of the tile.
    """
    i, b, j = wp.tid()
    v = (first_tile + i) * TILE + j
    if v >= blocks_out.shape[0]:
        return
    block = blocks_out.dtype()
    width = len(block[0])
    first = b * width
    chosen = row_in.shape[0] > 0
    frame_count = wp.where(chosen, row_in.shape[0], points_in.shape[0])
    # Lanes beyond the last frame read it too: no lane waits for a branch.
    for k in range(width):
        row = wp.min(first + k, frame_count - 1)
        if chosen:
            row = row_in[row]
        p = (points_in[row, v] - origin) * scale
        if first + k < frame_count:
            block[0, k] = p[0]
            block[1, k] = p[1]
            block[2, k] = p[2]
    blocks_out[v, b] = block


@lane_kernel(blocks_in=POINTS_ARRAY)
def unpack_frames(
    # in
    blocks_in: Any,
    first_tile: wp.int32,
    # out
    points_out: wp.array2d[wp.vec3],
):
    """(F, V) points of blocks (V, B); threads as of :func:`pack_frames`."""
    i, b, j = wp.tid()
    v = (first_tile + i) * TILE + j
    if v >= blocks_in.shape[0]:
        return
    block = blocks_in[v, b]
    width = len(block[0])
    for k in range(width):
        t = b * width + k
        if t < points_out.shape[0]:
            points_out[t, v] = wp.vec3(block[0, k], block[1, k], block[2, k])


@lane_kernel(blocks=POINTS_ARRAY)
def put_points(
    # in
    points_in: wp.array2d[wp.vec3],
    vertex_in: wp.array[wp.int32],
    middle_in: wp.array[wp.vec3],
    unit_in: wp.array[wp.float64],
    # in and out
    blocks: Any,
    precise: wp.array2d[wp.vec3d],
):
    """Put points (F, n) where vertices (n,) belong, about the middle of each frame and in its unit.

    In blocks (V, B) of single precision, and (F, V) in double precision. Of single ones the middle goes first, which
    costs no digit.
    """
    i, b = wp.tid()
    v = vertex_in[i]
    block = blocks.dtype()
    width = len(block[0])
    for k in range(width):
        t = b * width + k
        if t < points_in.shape[0]:
            scale = wp.float64(1.0) / unit_in[t]
            p = (points_in[t, i] - middle_in[t]) * wp.float32(scale)
            block[0, k] = p[0]
            block[1, k] = p[1]
            block[2, k] = p[2]
            precise[t, v] = (wp.vec3d(points_in[t, i]) - wp.vec3d(middle_in[t])) * scale
    blocks[v, b] = block
