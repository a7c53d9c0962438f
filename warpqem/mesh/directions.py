"""Directions of vectors."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["unit_vectors"]


def unit_vectors(vectors: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
    """Vectors (..., 3) of length one in double precision; those without a finite length become zero."""
    given = vectors.astype(np.float64)
    with np.errstate(over="ignore", invalid="ignore"):
        length = np.linalg.norm(given, axis=-1, keepdims=True)
        return np.divide(given, length, out=np.zeros_like(given), where=(length > 0) & np.isfinite(length))
