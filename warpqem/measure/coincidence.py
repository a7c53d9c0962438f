"""Vertices that are at the same place."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["coincident"]


def coincident(points: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
    """(V,) the first vertex at the place of each in all frames of (K, V, 3), or of more numbers than three."""
    rows = points.transpose(1, 0, 2).reshape(points.shape[1], -1)
    order = np.lexsort(rows.T)
    new = np.ones(len(rows), dtype=bool)
    new[1:] = (rows[order[1:]] != rows[order[:-1]]).any(axis=1)
    first = np.minimum.reduceat(order, np.flatnonzero(new)) if len(rows) else order
    label = np.empty(len(rows), dtype=np.int64)
    label[order] = first[np.cumsum(new) - 1]
    return label
