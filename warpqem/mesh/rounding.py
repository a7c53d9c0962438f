"""What single precision takes of a shape that is far from the origin."""

from __future__ import annotations

import warnings

import numpy as np

__all__ = ["rounding_lines", "rounding_of", "warn_of_rounding"]

# From this on it is said, in % of the diagonal: a tenth of the RMS distance that counts as good.
NOTED = 0.01


def rounding_of(low: np.ndarray, high: np.ndarray, origin: np.ndarray, diagonal: float) -> float:
    """How far single precision moves a coordinate at most, in % of a diagonal.

    Args:
        low: (F, 3) lowest corners of the frames, about ``origin``.
        high: (F, 3) highest corners.
        origin: (3,) float64.
        diagonal: in the units of the points.
    """
    corners = np.stack([low, high]).astype(np.float64)
    # About the origin the work is done, and without it the result is returned.
    largest = max(np.abs(corners).max(), np.abs(corners + origin).max())
    return 50.0 * float(np.spacing(np.float32(min(largest, np.finfo(np.float32).max)))) / diagonal


def rounding_lines(rounding: float) -> list[str]:
    """A line about it where it is noticeable."""
    if rounding <= NOTED:
        return []
    return [
        f"single precision moves the points of the result by up to {rounding:.2g} % of the diagonal, as they are that "
        "far from the origin: take an offset off them before, and add it afterwards in double precision"
    ]


def warn_of_rounding(rounding: float) -> None:
    """Give a UserWarning where it is noticeable."""
    for line in rounding_lines(rounding):
        warnings.warn(line, stacklevel=2)
