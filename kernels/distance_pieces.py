"""Pieces that are within a limit in one frame, looked at in many others: see :mod:`warpqem.kernels.distance_bound`.

Each corner of a piece has a partner on one face, by the same weights in every frame. The distance between a point of
the piece and its partner is convex, so it is largest at a corner: a piece is within the limit where its corners are.
This is sure in one direction only; where a pair is too far apart, the face may still be near, or another one.
"""

from typing import Any

import warp as wp

from warpqem.kernels.distance_bound import Pieces
from warpqem.kernels.lanes import POINTS_ARRAY, lane_dot, lane_kernel

wp.set_module_options({"enable_backward": False})  # no gradients are taken


@lane_kernel(own=POINTS_ARRAY, other=POINTS_ARRAY)
def check_pieces(
    # in
    own: Any,
    other: Any,
    own_vertex: wp.array[wp.int32],
    other_vertex: wp.array[wp.int32],
    pieces: Pieces,
    squared: wp.float32,
    # out
    apart_out: wp.array2d[wp.int32],
):
    """In which frames of a block (bits) a corner of each piece is further than that, squared, from its partner: (M, B).

    ``own`` (V, B) and ``other`` (W, B) are points of unit size, ``own_vertex`` and ``other_vertex`` corners of faces.
    """
    piece, block = wp.tid()
    i = 3 * pieces.owner[piece]
    j = 3 * pieces.face[piece]
    a = own[own_vertex[i], block]
    ab = own[own_vertex[i + 1], block] - a
    ac = own[own_vertex[i + 2], block] - a
    d = other[other_vertex[j], block]
    de = other[other_vertex[j + 1], block] - d
    df = other[other_vertex[j + 2], block] - d
    ad = a - d
    far = 0.0 * a[0]
    for k in range(3):
        offset = ad + pieces.weight[piece, k, 0] * ab + pieces.weight[piece, k, 1] * ac
        offset = offset - pieces.weight[piece, k, 2] * de - pieces.weight[piece, k, 3] * df
        length = lane_dot(offset, offset)
        for lane in range(len(far)):
            # What is no number is not within.
            far[lane] = wp.where(length[lane] <= squared, far[lane], 1.0)
    apart = wp.int32(0)
    for lane in range(len(far)):
        if far[lane] > 0.0:
            apart += 1 << lane
    apart_out[piece, block] = apart
