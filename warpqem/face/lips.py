"""Lips that touch: upper ones do not sink into lower ones."""

from __future__ import annotations

import numpy as np

__all__ = ["keep_apart", "lip_pairs"]


def lip_pairs(points: np.ndarray, side: np.ndarray, reach: float) -> np.ndarray:
    """(m, 2) int, for vertices of each lip the nearest one of the other lip, upper first, if within reach.

    Args:
        points: (V, 3) at rest.
        side: (V,) 1 on the upper lip, -1 on the lower one.
        reach: in the unit of the points.
    """
    from scipy.spatial import cKDTree

    upper, lower = np.flatnonzero(side == 1), np.flatnonzero(side == -1)
    if not len(upper) or not len(lower):
        return np.zeros((0, 2), dtype=np.int64)
    down, below = cKDTree(points[lower]).query(points[upper])
    up, above = cKDTree(points[upper]).query(points[lower])
    pairs = np.concatenate(
        [
            np.stack([upper, lower[below]], axis=1)[down <= reach],
            np.stack([upper[above], lower], axis=1)[up <= reach],
        ]
    )
    return np.unique(pairs, axis=0)


def keep_apart(points: np.ndarray, neutral: np.ndarray, pairs: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Points (V, 3) with both ends of each pair moved half way out of each other, if they are deeper than at rest."""
    if not len(pairs):
        return points
    upper, lower = pairs.T
    allowed = np.minimum((neutral[upper] - neutral[lower]) @ up, 0.0)
    lack = np.maximum(allowed - (points[upper] - points[lower]) @ up, 0.0) / 2
    lift = np.zeros(len(points))
    np.maximum.at(lift, upper, lack)
    sink = np.zeros(len(points))
    np.maximum.at(sink, lower, lack)
    return np.asarray(points + (lift - sink)[:, None] * up)
