"""Turned triangles put right in NumPy: all triangles of a round at once."""

from __future__ import annotations

import numpy as np

from warpqem.attribute_fit.turned_triangles import MARGINS, ROUNDS, areas_at

Array = np.ndarray


def turned_back(corner_row: Array, values: Array, signs: Array, lower: Array, upper: Array) -> Array:
    """What `warpqem.attribute_fit.turned_triangles.turned_back` gives, to the bit."""
    for margin in MARGINS:
        turned = _is_turned(_written_areas(values, corner_row), signs)
        if not turned.any():
            break
        values = _improved(corner_row, values, signs, turned, lower, upper, margin)
    return values


def _written_areas(values: Array, rows: Array) -> Array:
    """`areas_at` by the values as files hold them: rounding turns triangles over that are next to none."""
    return areas_at(values.astype(np.float32).astype(np.float64), rows)


def _is_turned(areas: Array, signs: Array) -> Array:
    return np.asarray(areas * signs < 0, dtype=bool)


def _improved(
    corner_row: Array,
    values: Array,
    signs: Array,
    turned: Array,
    lower: Array,
    upper: Array,
    margin: float,
) -> Array:
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
        if not move.any() and np.array_equal(np.clip(trial, lower, upper), trial):
            # Nothing that may move puts any of them right.
            break
        asked, total = np.maximum(np.bincount(row, minlength=len(values)), 1), np.empty_like(trial)
        for k in (0, 1):
            np.divide(np.bincount(row, move[:, :, k].ravel(), len(values)), asked, out=total[:, k])
        trial = np.clip(trial + total, lower, upper)
    return best


def _faces_at(corner_row: Array, rows: Array, row_count: int) -> Array:
    """Faces (N',) with one of some rows at a corner."""
    chosen = np.zeros(row_count, dtype=bool)
    chosen[rows] = True
    return np.asarray(chosen[corner_row].any(axis=1), dtype=bool)
