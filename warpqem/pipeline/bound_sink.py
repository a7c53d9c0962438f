"""Frames on their way to a sink, looked at whether they are within a distance of the input's."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from warpqem.arguments.distance_limit import DistanceLimit
from warpqem.frames.stream import FrameSink, counted_frames
from warpqem.measure.bound import DistanceBound, Excess
from warpqem.measure.collapsed import sizes
from warpqem.measure.unit_frames import UnitBlock, UnitFrames
from warpqem.mesh.mesh_input import MeshInput
from warpqem.runtime.device import device_turn

__all__ = ["BoundSink", "ExceededError", "LimitFrames"]

# A frame in which the mesh is invisible is bounded as if it were so many times smaller: nothing in it is too far.
UNSEEN = 1e9


class ExceededError(Exception):
    """A distance does not hold; ``excess`` says where. Never seen by callers of the package."""

    def __init__(self, excess: Excess) -> None:
        super().__init__()
        self.excess = excess


class LimitFrames:
    """Frames of the input at a size of one or less, in which the limit is the same in all; the last block is kept.

    Args:
        mesh: the input.
        limit: distance.
        diagonal: the largest diagonal, which stands for that of a frame without extent beyond rounding.
        device: Warp device.
    """

    def __init__(self, mesh: MeshInput, limit: DistanceLimit, diagonal: float, device: str) -> None:
        self._mesh, self._limit, self._diagonal, self._device = mesh, limit, diagonal, device
        self._counted = counted_frames(mesh.source)
        self._kept: tuple[object, UnitFrames, UnitBlock] | None = None

    def block(self, frames: slice) -> tuple[UnitFrames, UnitBlock]:
        """Consecutive frames."""
        key = frames.start, frames.stop
        if self._kept is None or self._kept[0] != key:
            points = self._mesh.source.read(frames)
            units = self.units(points, np.arange(frames.start, frames.stop))
            self._kept = key, units, UnitBlock(points, units, self._device)
        return self._kept[1:]

    def units(self, points: npt.NDArray[np.floating], frames: npt.NDArray[np.integer]) -> UnitFrames:
        """What brings frames (n, V, 3) to unit size, those in which nobody sees the mesh to next to none."""
        used = points if self._mesh.used.all() else points[:, self._mesh.used]
        low, high = used.min(axis=1).astype(np.float64), used.max(axis=1).astype(np.float64)
        units = self._limit.units(sizes(used, self._diagonal), self._diagonal)
        return UnitFrames((low + high) / 2, np.where(self._counted[frames], units, UNSEEN * units))


class BoundSink:
    """Passes frames on, and looks for those that are too far from the input.

    Args:
        sink: takes the frames.
        mesh: the input.
        limit: distance.
        diagonal: the largest diagonal, which stands for that of a frame without extent beyond rounding.
        device: Warp device.
    """

    def __init__(self, sink: FrameSink, mesh: MeshInput, limit: DistanceLimit, diagonal: float, device: str) -> None:
        self._sink, self._mesh, self._limit, self._device = sink, mesh, limit.relative(diagonal), device
        self._frames = LimitFrames(mesh, limit, diagonal, device)
        self._bound: DistanceBound | None = None

    def begin(self, frame_count: int, vertex_count: int, faces: np.ndarray) -> None:
        """Begin a mesh of so many frames."""
        self._sink.begin(frame_count, vertex_count, faces)
        self._bound = DistanceBound(self._mesh.faces, faces, self._limit, self._device)

    def write(self, frames: slice, points: np.ndarray) -> None:
        """Check consecutive frames.

        Raises:
            ExceededError: one is too far.
        """
        self._sink.write(frames, points)
        assert self._bound is not None
        with device_turn(self._device):
            units, reference = self._frames.block(frames)
            excess = self._bound.excess_of_blocks(
                frames.start, reference, UnitBlock(points, units, self._device), enough=0
            )
        if excess is not None:
            raise ExceededError(excess)
