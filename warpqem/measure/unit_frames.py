"""Frames of a mesh brought to about unit size around the origin, on the device."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.frames.blocks import block_width, pack_frames
from warpqem.kernels import lanes as kernels
from warpqem.kernels.lanes import POINTS, width_of
from warpqem.runtime import new_arrays
from warpqem.runtime.device import device_traits
from warpqem.runtime.part_launches import columns_of, launch_in_parts, rows_of

__all__ = ["ChangingBlock", "UnitBlock", "UnitFrames"]


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

    @property
    def vertex_count(self) -> int:
        """Vertices V."""
        return self._points.shape[1]

    @functools.cached_property
    def double(self) -> wp.array:
        """(n, V) double precision."""
        return wp.array(self._frames.double(self._points), dtype=wp.vec3d, device=self._device, copy=False)

    @functools.cached_property
    def lanes(self) -> wp.array:
        """(V, B) blocks of frames, single precision."""
        width = block_width(len(self), self._device)
        middle, unit = self._frames.middle, self._frames.unit
        alike = bool(len(unit)) and (middle == middle[0]).all() and (unit == unit[0]).all()
        if alike and self._points.dtype == np.float32 and device_traits(self._device).own_memory:
            # What single() does, there.
            centre, scale = middle[0].astype(np.float32), float(np.float32(1.0 / unit[0]))
            return pack_frames(self._points, self._device, centre=centre, scale=scale, width=width)
        return pack_frames(self._frames.single(self._points), self._device, width=width)


class ChangingBlock(UnitBlock):
    """The same of a mesh whose vertices are put in place some at a time.

    Args:
        shape: frames n and vertices V.
        frames: what brings them to unit size.
        device: Warp device.
    """

    def __init__(self, shape: tuple[int, int], frames: UnitFrames, device: str) -> None:
        # Vertices that are not there yet lie in the middle.
        super().__init__(np.broadcast_to(frames.middle[:, None], (*shape, 3)), frames, device)
        width = block_width(len(self), device)
        self._middle = new_arrays.uploaded(frames.middle.astype(np.float32), dtype=wp.vec3, device=device)
        self._unit = new_arrays.uploaded(frames.unit, dtype=wp.float64, device=device)
        self.double = wp.zeros(shape, dtype=wp.vec3d, device=device)
        self.lanes = wp.zeros((shape[1], -(-shape[0] // width)), dtype=POINTS[width], device=device)

    def put(self, vertex: wp.array, points: wp.array) -> None:
        """Put some vertices (m,) int32 where they are, (n, m) points in the caller's coordinates, all on the device."""
        launch_in_parts(
            kernels.put_points[width_of(self.lanes)],
            (len(vertex), self.lanes.shape[1]),
            [columns_of(points), rows_of(vertex), self._middle, self._unit],
            [self.lanes, self.double],
            device=self._device,
        )
