"""Triangles that texture coordinates turn over, put right by small moves of their corners.

Each turned triangle asks for the least move of its corners that gives it some area of the right sign: a step of
Kaczmarz (1937) on its signed area, as in position-based dynamics. Corners take the mean of what their triangles ask
for; then the next round looks again.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.kernels import turned_triangles as kernels
from warpqem.runtime import new_arrays
from warpqem.runtime.launches import launch

__all__ = ["areas_at", "turned_back"]

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]
Signs = npt.NDArray[np.int8]

# Twice the area that a triangle is to get, in parts of its squared longest edge: little at first, as the least change
# is the nearest to the fit; more where that left some. With these one was left on 620 meshes and levels, where steps of
# ten left fourteen.
MARGINS = (0.0003, 0.003, 0.01, 0.03, 0.1, 0.3)
# Rounds with each. Of those that come right most do so in the first ten.
ROUNDS = 60
HOST = "cpu"


def areas_at(values: Floats, rows: Ints) -> Floats:
    """Twice the areas (N,) of triangles whose corners have rows (N, 3) of values (R, 2); counter-clockwise is positive.

    Column by column: twice as fast as corner by corner, to the same bits.
    """
    one, two, three = (np.ascontiguousarray(rows[:, k]) for k in range(3))
    (x, y), (x_first, y_first) = values.T, (channel.take(one) for channel in values.T)
    found: Floats = (x.take(two) - x_first) * (y.take(three) - y_first)
    found -= (y.take(two) - y_first) * (x.take(three) - x_first)
    return found


def turned_back(corner_row: Ints, values: Floats, signs: Signs, lower: Floats, upper: Floats) -> Floats:
    """Values with fewer triangles that are turned over, if that can be done; never with more.

    The host does it on any device: one small step hangs on the one before, of few triangles.

    Args:
        corner_row: (N', 3) int32, which of R values each corner has.
        values: (R, 2) float64.
        signs: (N',) which way each triangle is to turn; 0 for either.
        lower: (R, 2) float64, the least that values may be.
        upper: (R, 2) float64, the most.
    """
    (face_count, _), row_count = corner_row.shape, len(values)
    chart, rounds = kernels.Chart(), kernels.Rounds()
    chart.corner_row, chart.sign = _given(corner_row, wp.int32), _given(signs, wp.int32)
    chart.lower, chart.upper = _given(lower, wp.float64), _given(upper, wp.float64)
    rounds.mark, rounds.asked = _zeros(row_count, wp.int32), _zeros(row_count, wp.int32)
    rounds.watched, rounds.area = _zeros(face_count, wp.int32), _zeros(face_count, wp.float64)
    rounds.trial, rounds.total = _zeros((row_count, 2), wp.float64), _zeros((row_count, 2), wp.float64)
    changed = new_arrays.uploaded(values, dtype=wp.float64, device=HOST)
    launch(kernels.turn_back, 1, [chart, _given(MARGINS, wp.float64), ROUNDS], [changed, rounds], device=HOST)
    found: Floats = changed.numpy()
    return found


def _given(values: npt.ArrayLike, dtype: type) -> wp.array:
    return new_arrays.uploaded(values, dtype=dtype, device=HOST, copy=False)


def _zeros(shape: int | tuple[int, int], dtype: type) -> wp.array:
    return new_arrays.zeros(shape, dtype=dtype, device=HOST)
