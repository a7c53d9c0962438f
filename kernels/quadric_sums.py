"""Weighted sums of other vertices' quadrics, as part of the quadric of a vertex."""

from typing import Any

import warp as wp

from warpqem.kernels.lanes import POINTS_ARRAY, QUADRIC_ARRAY, lane_kernel
from warpqem.kernels.mesh_state import AnyKeyFrames, MeshState
from warpqem.kernels.quadric import shift_origin, zero_quadric

wp.set_module_options({"enable_backward": False})  # no gradients are taken


@lane_kernel(position_in=POINTS_ARRAY, quadric_in=QUADRIC_ARRAY, sum_out=QUADRIC_ARRAY)
def gather_sums(
    # in
    row_in: wp.array[wp.int32],
    start_in: wp.array[wp.int32],
    vertex_in: wp.array[wp.int32],
    weight_in: wp.array[wp.float32],
    position_in: Any,
    quadric_in: Any,
    # out
    sum_out: Any,
):
    """Sum of row ``i`` (R, B), about its vertex ``row_in[i]``: one thread adds the entries in their order."""
    i, t = wp.tid()
    x = position_in[row_in[i], t]
    q = zero_quadric(x)
    for j in range(start_in[i], start_in[i + 1]):
        v = vertex_in[j]
        q += shift_origin(quadric_in[v, t], x - position_in[v, t]) * weight_in[j]
    sum_out[i, t] = q


@lane_kernel(sum_in=QUADRIC_ARRAY, quadric=QUADRIC_ARRAY)
def add_sums(
    # in
    row_in: wp.array[wp.int32],
    sum_in: Any,
    # in and out
    quadric: Any,
):
    """Add each row's sum (R, B) to the quadric of its vertex."""
    i, t = wp.tid()
    quadric[row_in[i], t] = quadric[row_in[i], t] + sum_in[i, t]


@wp.func
def merge_sum(state: MeshState, frames: AnyKeyFrames, u: wp.int32, v: wp.int32, x: Any, t: wp.int32):
    """Add up the sums kept for ``u`` and ``v`` in block ``t``, about ``x``, where ``u`` goes.

    ``frames.position`` is where both still are, and ``state.sum_row`` that of both.
    """
    own = state.sum_row[u]
    other = state.sum_row[v]
    if own < 0 and other < 0:
        return
    q = zero_quadric(x)
    if own >= 0:
        q += shift_origin(frames.kept_sum[own, t], x - frames.position[u, t])
    if other >= 0:
        q += shift_origin(frames.kept_sum[other, t], x - frames.position[v, t])
    frames.kept_sum[wp.where(own >= 0, own, other), t] = q


@wp.func
def merge_sum_rows(state: MeshState, u: wp.int32, v: wp.int32):
    """The row of what ``u`` and ``v`` become, once its sums are merged."""
    if state.sum_row[u] < 0:
        state.sum_row[u] = state.sum_row[v]
