"""Where the middle of an eye is, told by its lids where they close in motion."""

from __future__ import annotations

import numpy as np

__all__ = ["closing_lid"]

# Lids that come down by this much against what is around them, in noses, close.
MIN_DROP = 0.06
# What comes down by this share of the most is the lid.
LID_SHARE = 0.6


def closing_lid(place: np.ndarray, rise: np.ndarray, near: tuple[float, float], reach: float) -> float | None:
    """Left coordinate of the middle of a lid that closes; None if none does.

    Args:
        place: (n, 3) vertices, in noses.
        rise: (F, n) their upward motion, apart from the head's.
        near: left and up coordinate of where an eye is expected.
        reach: how far from there, each way.
    """
    around = (np.abs(place[:, 0] - near[0]) < 2.0 * reach) & (np.abs(place[:, 1] - near[1]) < 2.0 * reach)
    if np.count_nonzero(around) < 8:
        return None
    own = rise[:, around]
    drop = (np.median(own, axis=1, keepdims=True) - own).max(axis=0)
    if drop.max() < MIN_DROP:
        return None
    lid = drop > LID_SHARE * drop.max()
    left = float(np.average(place[around, 0][lid], weights=drop[lid]))
    return left if abs(left - near[0]) <= reach else None
