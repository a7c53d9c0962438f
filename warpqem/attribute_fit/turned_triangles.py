"""Triangles that texture coordinates turn over, put right by small moves of their corners.

Each turned triangle asks for the least move of its corners that gives it some area of the right sign: a step of
Kaczmarz (1937) on its signed area, as in position-based dynamics. Corners take the mean of what their triangles ask
for; then the next round looks again.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

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


def areas_at(values: Floats, rows: Ints) -> Floats:
    """Twice the areas (N,) of triangles whose corners have rows (N, 3) of values (R, 2); counter-clockwise is positive.

    Column by column: twice as fast as corner by corner, to the same bits.
    """
    one, two, three = (np.ascontiguousarray(rows[:, k]) for k in range(3))
    (x, y), (x_first, y_first) = values.T, (channel.take(one) for channel in values.T)
    found: Floats = (x.take(two) - x_first) * (y.take(three) - y_first)
    found -= (y.take(two) - y_first) * (x.take(three) - x_first)
    return found


def turned_back(corner_row: Ints, values: Floats, signs: Signs, clip: Callable[[Floats], Floats]) -> Floats:
    """Values with fewer triangles that are turned over, if that can be done; never with more.

    Args:
        corner_row: (N', 3) int32, which of R values each corner has.
        values: (R, 2) float64.
        signs: (N',) which way each triangle is to turn; 0 for either.
        clip: what keeps (R, 2) within where values may be.
    """
    for margin in MARGINS:
        turned = _is_turned(_written_areas(values, corner_row), signs)
        if not turned.any():
            break
        values = _improved(corner_row, values, signs, turned, clip, margin)
    return values


def _written_areas(values: Floats, rows: Ints) -> Floats:
    """`areas_at` by the values as files hold them: rounding turns triangles over that are next to none."""
    return areas_at(values.astype(np.float32).astype(np.float64), rows)


def _is_turned(areas: Floats, signs: Signs) -> npt.NDArray[np.bool_]:
    return np.asarray(areas * signs < 0, dtype=bool)


def _improved(
    corner_row: Ints,
    values: Floats,
    signs: Signs,
    turned: npt.NDArray[np.bool_],
    clip: Callable[[Floats], Floats],
    margin: float,
) -> Floats:
    """The best values of so many rounds with one margin."""
    # Neighbours of turned triangles may have to move, too; what is further off stays.
    beside = _faces_at(corner_row, corner_row[turned], len(values))
    movable = np.zeros(len(values), dtype=bool)
    movable[corner_row[beside]] = True
    watched = corner_row[_faces_at(corner_row, np.flatnonzero(movable), len(values)) & (signs != 0)]
    wanted = signs[movable[corner_row].any(axis=1) & (signs != 0)].astype(np.float64)
    best, left, trial = values, int(turned.sum()), values
    for _ in range(ROUNDS):
        areas = wanted * _written_areas(trial, watched)
        count = int((areas < 0).sum())
        if count < left:
            best, left = trial, count
        # A triangle without area is next to one that is turned over.
        flat = np.flatnonzero(areas <= 0)
        if not len(flat):
            break
        rows = watched[flat]
        corner = trial[rows]
        opposite = corner.take((1, 2, 0), axis=1) - corner.take((2, 0, 1), axis=1)
        turn = wanted[flat, None] * movable[rows]
        gradient = np.empty_like(opposite)
        np.multiply(opposite[:, :, 1], turn, out=gradient[:, :, 0])
        np.multiply(-opposite[:, :, 0], turn, out=gradient[:, :, 1])
        missing = margin * (opposite**2).sum(axis=2).max(axis=1) - areas[flat]
        squared = (gradient**2).sum(axis=(1, 2))
        share = np.divide(missing, squared, out=np.zeros_like(missing), where=squared > 0)
        move, row = share[:, None, None] * gradient, rows.ravel()
        if not move.any() and np.array_equal(clip(trial), trial):
            # Nothing that may move puts any of them right.
            break
        asked, total = np.maximum(np.bincount(row, minlength=len(values)), 1), np.empty_like(trial)
        for k in (0, 1):
            np.divide(np.bincount(row, move[:, :, k].ravel(), len(values)), asked, out=total[:, k])
        trial = clip(trial + total)
    return best


def _faces_at(corner_row: Ints, rows: npt.NDArray[np.integer], row_count: int) -> npt.NDArray[np.bool_]:
    """Faces (N',) with one of some rows at a corner."""
    chosen = np.zeros(row_count, dtype=bool)
    chosen[rows] = True
    return np.asarray(chosen[corner_row].any(axis=1), dtype=bool)
