"""Rows of positions in another order of the vertices."""

from typing import Any

import warp as wp

from warpqem.kernels.lanes import POINTS_ARRAY, lane_kernel


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
