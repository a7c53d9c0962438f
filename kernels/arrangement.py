"""Vertices and faces along a space-filling curve, and values in another order of them."""

from typing import Any

import warp as wp

from warpqem.kernels.lanes import POINTS_ARRAY, lane_kernel
from warpqem.kernels.work import Work

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# A vertex's cell in each direction: three such numbers fill a 32-bit key.
CELL_BITS = wp.constant(wp.int32(10))
CELLS = wp.constant(wp.float64(2 ** int(CELL_BITS)))


@wp.struct
class Bounds:
    """The corners of a box, a number for each axis."""

    low: wp.array[wp.float32]  # (3,) at first inf
    high: wp.array[wp.float32]  # (3,) at first -inf


@wp.func
def spread_bits(number: wp.int32) -> wp.int32:
    """The lower ten bits of a number, with two zeros between them."""
    bits = number & 0x3FF
    bits = (bits | bits << 16) & 0x30000FF
    bits = (bits | bits << 8) & 0x300F00F
    bits = (bits | bits << 4) & 0x30C30C3
    return (bits | bits << 2) & 0x9249249


@lane_kernel(position_in=POINTS_ARRAY)
def find_bounds(
    # in
    position_in: Any,
    work: Work,
    # in and out
    bounds: Bounds,
):
    """The box around all vertices in the first frame: least and largest numbers are the same in any order."""
    low = wp.vec3(wp.inf)
    high = wp.vec3(-wp.inf)
    for v in range(wp.tid(), position_in.shape[0], work.thread_count):
        block = position_in[v, 0]
        p = wp.vec3(block[0, 0], block[1, 0], block[2, 0])
        low = wp.min(low, p)
        high = wp.max(high, p)
    for axis in range(3):
        wp.atomic_min(bounds.low, axis, low[axis])
        wp.atomic_max(bounds.high, axis, high[axis])


@lane_kernel(position_in=POINTS_ARRAY)
def key_vertices(
    # in
    position_in: Any,
    bounds: Bounds,
    # out
    key_out: wp.array[wp.int32],
    vertex_out: wp.array[wp.int32],
):
    """The Morton code of each vertex in the first frame: the bits of its cell in x, y and z, interleaved."""
    v = wp.tid()
    block = position_in[v, 0]
    extent = wp.float32(0.0)
    for axis in range(3):
        extent = wp.max(extent, bounds.high[axis] - bounds.low[axis])
    scale = wp.float32(0.0)
    if extent > 0.0:
        scale = wp.float32((CELLS - wp.float64(1.0)) / wp.float64(extent))
    key = wp.int32(0)
    for axis in range(3):
        key = key | spread_bits(wp.int32((block[axis, 0] - bounds.low[axis]) * scale)) << axis
    key_out[v] = key
    vertex_out[v] = v


@wp.kernel
def invert_order(
    # in
    item_in: wp.array[wp.int32],
    # out
    place_out: wp.array[wp.int32],
):
    """Where each item of a permutation is."""
    i = wp.tid()
    place_out[item_in[i]] = i


@wp.kernel
def key_faces(
    # in
    corner_vertex_in: wp.array[wp.int32],
    place_in: wp.array[wp.int32],
    # out
    key_out: wp.array[wp.int32],
    face_out: wp.array[wp.int32],
):
    """The first place of each face's corners."""
    f = wp.tid()
    one = place_in[corner_vertex_in[3 * f]]
    two = place_in[corner_vertex_in[3 * f + 1]]
    three = place_in[corner_vertex_in[3 * f + 2]]
    key_out[f] = wp.min(wp.min(one, two), three)
    face_out[f] = f


@wp.kernel
def rearrange_corners(
    # in
    corner_vertex_in: wp.array[wp.int32],
    place_in: wp.array[wp.int32],
    face_in: wp.array[wp.int32],
    # out
    corner_vertex_out: wp.array[wp.int32],
):
    """The faces in another order, over vertices in another order."""
    f = wp.tid()
    for k in range(3):
        corner_vertex_out[3 * f + k] = place_in[corner_vertex_in[3 * face_in[f] + k]]


@lane_kernel(rows_in=POINTS_ARRAY, rows_out=POINTS_ARRAY)
def gather_rows(
    # in
    rows_in: Any,
    vertex_in: wp.array[wp.int32],
    # out
    rows_out: Any,
):
    """The row of ``vertex_in[i]`` at place ``i``."""
    i, t = wp.tid()
    rows_out[i, t] = rows_in[vertex_in[i], t]


@wp.kernel
def gather_integers(
    # in
    values_in: wp.array2d[wp.int32],
    item_in: wp.array[wp.int32],
    # out
    values_out: wp.array2d[wp.int32],
):
    """The values of ``item_in[i]`` at place ``i``."""
    i, k = wp.tid()
    values_out[i, k] = values_in[item_in[i], k]


@wp.kernel
def gather_numbers(
    # in
    values_in: wp.array2d[wp.float32],
    item_in: wp.array[wp.int32],
    # out
    values_out: wp.array2d[wp.float32],
):
    """The values of ``item_in[i]`` at place ``i``."""
    i, k = wp.tid()
    values_out[i, k] = values_in[item_in[i], k]
