"""Pieces that are within a limit in one frame, looked at in many others: see :mod:`warpqem.kernels.distance_bound`.

Each corner of a piece has a partner on one face, by the same weights in every frame. The distance between a point of
the piece and its partner is convex, so it is largest at a corner: a piece is within the limit where its corners are.
This is sure in one direction only; where a pair is too far apart, the face may still be near, or another one.
"""

from typing import Any

import warp as wp

from warpqem.kernels.distance_bound import Pieces
from warpqem.kernels.lanes import POINTS_ARRAY, lane_dot, lane_kernel, lane_scale, lane_sum

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# Squared lengths and areas below are nothing: no division by them overflows.
MIN_SQUARED = wp.constant(wp.float32(1.0e-30))


@wp.func
def lane_from_segment(p: Any, d: Any):
    """Squared distances (width,) of points p (3, width) from segments from the origin to d."""
    along = lane_dot(p, d)
    length = lane_dot(d, d)
    for lane in range(len(along)):
        along[lane] = wp.clamp(along[lane] / wp.max(length[lane], MIN_SQUARED), 0.0, 1.0)
    offset = p - lane_scale(along, d)
    return lane_dot(offset, offset)


@wp.func
def lane_foot_squared(p: Any, e: Any, f: Any):
    """Squared distances (width,) of points p (3, width) from their feet on the planes of triangles of the origin, e, f.

    Feet beyond the triangle are moved into it: no less than the distance.
    """
    ee = lane_dot(e, e)
    ef = lane_dot(e, f)
    ff = lane_dot(f, f)
    pe = lane_dot(p, e)
    pf = lane_dot(p, f)
    area = wp.cw_mul(ee, ff) - wp.cw_mul(ef, ef)
    v = wp.cw_mul(ff, pe) - wp.cw_mul(ef, pf)
    w = wp.cw_mul(ee, pf) - wp.cw_mul(ef, pe)
    for lane in range(len(v)):
        inverse = 1.0 / wp.max(area[lane], MIN_SQUARED)
        v[lane] = wp.clamp(v[lane] * inverse, 0.0, 1.0)
        w[lane] = wp.clamp(w[lane] * inverse, 0.0, 1.0 - v[lane])
    offset = p - lane_scale(v, e) - lane_scale(w, f)
    return lane_dot(offset, offset)


@wp.func
def lane_distance_squared(p: Any, e: Any, f: Any):
    """Squared distances (width,) of points p (3, width) from triangles of the origin, e and f: no less than they are.

    The nearest of the three edges and, where it lies inside, of the foot on the plane.
    """
    found = lane_from_segment(p, e)
    second = lane_from_segment(p, f)
    third = lane_from_segment(p - e, f - e)
    inside = lane_foot_squared(p, e, f)
    for lane in range(len(found)):
        found[lane] = wp.min(wp.min(found[lane], second[lane]), wp.min(third[lane], inside[lane]))
    return found


@lane_kernel(own=POINTS_ARRAY, other=POINTS_ARRAY)
def check_pieces(
    # in
    own: Any,
    other: Any,
    own_vertex: wp.array[wp.int32],
    other_vertex: wp.array[wp.int32],
    pieces: Pieces,
    squared: wp.float32,
    left: wp.array2d[wp.int32],
    # out
    apart_out: wp.array2d[wp.int32],
):
    """In which frames of a block (bits) a corner of each piece is further than that, squared, from its partner: (M, B).

    Only frames in ``left`` (P, B), bits by parent, are looked at.

    ``own`` (V, B) and ``other`` (W, B) are points of unit size, ``own_vertex`` and ``other_vertex`` corners of faces.
    """
    piece, block = wp.tid()
    asked = left[pieces.parent[piece], block]
    if asked == 0:
        apart_out[piece, block] = 0
        return
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
    if lane_sum(far) > 0.0:
        # Partners may follow the corners over the face: the points of it nearest to them.
        still = 0.0 * a[0]
        for k in range(3):
            offset = ad + pieces.weight[piece, k, 0] * ab + pieces.weight[piece, k, 1] * ac
            length = lane_foot_squared(offset, de, df)
            if not (wp.max(length) <= squared):
                length = lane_distance_squared(offset, de, df)
            for lane in range(len(far)):
                still[lane] = wp.where(length[lane] <= squared, still[lane], 1.0)
        for lane in range(len(far)):
            far[lane] = wp.min(far[lane], still[lane])
    apart = wp.int32(0)
    for lane in range(len(far)):
        if far[lane] > 0.0:
            apart += 1 << lane
    apart_out[piece, block] = apart & asked
