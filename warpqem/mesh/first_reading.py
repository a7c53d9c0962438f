"""The first look at all frames of a mesh, on the host or on a device: their bounds, and the frames brought there."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp

from warpqem.arguments.array_input import FLOAT32_MAX
from warpqem.frames.checked_frames import frame_bounds
from warpqem.frames.device_frames import BoundsMeter, HeldFrames
from warpqem.frames.device_source import DeviceFrames
from warpqem.frames.stream import FrameSource, read_ahead
from warpqem.runtime.device import device_traits
from warpqem.runtime.staging import Staged, Uploads

__all__ = ["FirstReading", "SeenFrames", "about_origin"]


@dataclass(frozen=True)
class SeenFrames:
    """Consecutive frames that were looked at.

    Attributes:
        frames: which they are.
        points: (n, V, 3) float32 about the origin, or (n, V) points on the device.
        low: (n, 3) float32, lowest corner of each frame.
        high: (n, 3) float32, highest corner of each frame.
        broken: (n, V, 3), the frames as they were read, where a point is not finite; the others do not count then.
    """

    frames: slice
    points: np.ndarray | wp.array
    low: np.ndarray
    high: np.ndarray
    broken: np.ndarray | None = None


class FirstReading:
    """Reads all frames of a source, once.

    Args:
        source: the frames.
        used: (V,) bool, the vertices that count for the bounds.
        device: Warp device, that of the frames where they are on one.
        hold: keep the frames there.

    Attributes:
        origin: (3,) float64, taken off before the points are rounded to float32; known with the first block.
        held: the frames on the device; None where they are brought there as they are needed.
    """

    def __init__(self, source: FrameSource, used: np.ndarray, device: str, hold: bool) -> None:
        self._source, self._used, self._device = source, used, device
        self._meter = BoundsMeter(used, device)
        self.origin = np.zeros(3)
        self.held: HeldFrames | None = None
        if isinstance(source, DeviceFrames) and source.whole is not None:
            self.held = HeldFrames(source.whole)
        elif hold:
            self.held = HeldFrames.empty(source.frame_count, source.vertex_count, device)

    def blocks(self, blocks: Sequence[slice]) -> Iterator[SeenFrames]:
        """Every block of frames."""
        if isinstance(self._source, DeviceFrames):
            return self._blocks_there(self._source, blocks)
        return self._blocks_here(blocks)

    def _blocks_here(self, blocks: Sequence[slice]) -> Iterator[SeenFrames]:
        if len(blocks) < 2 or not device_traits(self._device).own_memory:
            yield from self._look_through(read_ahead(self._unstaged, blocks), None)
            return
        with contextlib.closing(Uploads(self._device)) as uploads:
            yield from self._look_through(read_ahead(uploads.staged(self._source.read), blocks), uploads)

    def _unstaged(self, frames: slice) -> Staged:
        return Staged(self._source.read(frames), None)

    def _look_through(self, blocks: Iterator[tuple[slice, Staged]], uploads: Uploads | None) -> Iterator[SeenFrames]:
        """Blocks of the host; those that are staged are brought to the device while the next one is read."""
        none = np.empty((0, 3), dtype=np.float32)
        for frames, staged in blocks:
            raw = staged.points
            if raw.dtype != np.float32 and not _fits_single(raw):
                yield SeenFrames(frames, raw, none, none, raw)
                continue
            if frames.start == 0 and raw.dtype != np.float32:
                # float64 coordinates far from the origin keep their precision when the offset goes first.
                self.origin = raw[0, self._used].mean(axis=0)
            points = about_origin(raw, self.origin)
            if uploads is None or staged.buffer is None:
                low, high, finite = self._meter.measure(points, self.held, frames)
            else:
                low, high, finite = self._meter.measure_there(self._brought(staged, frames, uploads))
            yield SeenFrames(frames, points, low, high, None if finite else raw)

    def _brought(self, staged: Staged, frames: slice, uploads: Uploads) -> wp.array:
        """Consecutive frames on the device, where they are held or for now."""
        if self.held is None:
            return uploads.sent(staged)
        block = self.held.block(frames)
        uploads.send(staged, block)
        return block

    def _blocks_there(self, source: DeviceFrames, blocks: Sequence[slice]) -> Iterator[SeenFrames]:
        self.origin = source.first_origin(self._used)
        for frames in blocks:
            points = source.block(frames, self.origin, None if self.held is None else self.held.block(frames))
            low, high, finite = self._meter.measure_there(points)
            # The message of the error names values, which only then come to the host.
            yield SeenFrames(frames, points, low, high, None if finite else source.read(frames))


def about_origin(points: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Points minus ``origin`` as float32; float32 points have none."""
    return np.ascontiguousarray(points if points.dtype == np.float32 else points - origin, dtype=np.float32)


def _fits_single(points: np.ndarray) -> bool:
    """Whether all of them are finite, in single precision too."""
    low, high = frame_bounds(points)
    return bool(max(np.abs(low).max(), np.abs(high).max()) <= FLOAT32_MAX)
