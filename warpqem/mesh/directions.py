"""Directions of vectors."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["unit_vectors"]


def unit_vectors(vectors: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
    """Vectors (..., D) of length one in double precision; those without a finite length become zero."""
    given = vectors.astype(np.float64)
    with np.errstate(over="ignore", invalid="ignore"):
        # Column by column: NumPy takes twice as long along rows of three.
        first, *others = (given[..., k] for k in range(given.shape[-1]))
        squared = first * first
        for column in others:
            squared += column * column
        length = np.sqrt(squared)
        has_length = (length > 0) & np.isfinite(length)
        if has_length.all():
            return given / length[..., None]
        return np.divide(given, length[..., None], out=np.zeros_like(given), where=has_length[..., None])
