"""Arrays as short text, for a page that decodes them with what every browser has."""

from __future__ import annotations

import base64
import zlib
from dataclasses import dataclass

import numpy as np

__all__ = ["Grid", "encode"]

# Positions have 16 bits per component.
STEPS = 65535


@dataclass(frozen=True)
class Grid:
    """The 16-bit grid that positions are rounded to.

    Attributes:
        low: (3,) float64, its lowest corner.
        step: distance of two neighbours, the same along all axes.
    """

    low: np.ndarray
    step: float

    @classmethod
    def around(cls, *points: np.ndarray) -> Grid:
        """The finest grid that holds all points (..., 3)."""
        low = np.min([p.reshape(-1, 3).min(axis=0) for p in points], axis=0).astype(np.float64)
        high = np.max([p.reshape(-1, 3).max(axis=0) for p in points], axis=0).astype(np.float64)
        return cls(low, float((high - low).max()) / STEPS or 1.0)

    def round(self, points: np.ndarray) -> np.ndarray:
        """The nearest nodes of the grid, uint16 of the same shape."""
        return np.rint((points - self.low) / self.step).clip(0, STEPS).astype(np.uint16)


def encode(values: np.ndarray, over_time: bool = False) -> str:
    """Unsigned integers as text: byte planes, deflated (RFC 1950), in base64.

    The first bytes of all values come first, then the second ones: neighbours then differ little, and deflate
    finds that.

    Args:
        values: unsigned integers of any width.
        over_time: hold the differences along the first axis, modulo the width, instead of the values.
    """
    little = values.astype(values.dtype.newbyteorder("<"))
    if over_time:
        little[1:] -= little[:-1].copy()
    planes = little.reshape(-1, 1).view(np.uint8).T
    return base64.b64encode(zlib.compress(np.ascontiguousarray(planes).tobytes(), 6)).decode("ascii")
