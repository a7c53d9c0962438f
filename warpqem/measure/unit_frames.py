"""Frames of a mesh brought to about unit size around the origin, on the device."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.frames.blocks import block_width, pack_frames

__all__ = ["UnitBlock", "UnitFrames"]


@dataclass(frozen=True)
class UnitFrames:
    """How frames are brought to about unit size around the origin.

    Attributes:
        middle: (n, 3) float64, in the units of the points.
        unit: (n,) float64, the length that becomes one.
    """

    middle: npt.NDArray[np.float64]
    unit: npt.NDArray[np.float64]

    def single(self, points: npt.NDArray[np.floating]) -> npt.NDArray[np.float32]:
        """Points (n, V, 3) in single precision; of points in it the middle goes first, which costs no digit."""
        middle, scale = self.middle[:, None], (1.0 / self.unit)[:, None, None]
        if points.dtype != np.float32:
            return np.ascontiguousarray((points - middle) * scale, dtype=np.float32)
        placed = points - middle.astype(np.float32)
        placed *= scale.astype(np.float32)
        return placed

    def double(self, points: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
        """Points (n, V, 3) in double precision, about the same middles."""
        middle = self.middle
        if points.dtype == np.float32:
            middle = middle.astype(np.float32).astype(np.float64)
        placed = points - middle[:, None]
        placed *= (1.0 / self.unit)[:, None, None]
        return placed


class UnitBlock:
    """A block of frames of one mesh at unit size, made as it is asked for and kept.

    Args:
        points: (n, V, 3), in the caller's coordinates.
        frames: what brings them to unit size.
        device: Warp device.
    """

    def __init__(self, points: npt.NDArray[np.floating], frames: UnitFrames, device: str) -> None:
        self._points, self._frames, self._device = points, frames, device

    def __len__(self) -> int:
        return len(self._points)

    @functools.cached_property
    def double(self) -> wp.array:
        """(n, V) double precision."""
        return wp.array(self._frames.double(self._points), dtype=wp.vec3d, device=self._device, copy=False)

    @functools.cached_property
    def lanes(self) -> wp.array:
        """(V, B) blocks of frames, single precision."""
        width = block_width(len(self), self._device)
        return pack_frames(self._frames.single(self._points), self._device, width=width)
