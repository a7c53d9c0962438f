"""Frames as arrays on the device: measured there, and kept there for as long as they are needed."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp

from warpqem.frames.checked_frames import frame_bounds
from warpqem.frames.stream import read_ahead
from warpqem.kernels import frame_bounds as kernels
from warpqem.runtime import new_arrays
from warpqem.runtime.device import device_traits
from warpqem.runtime.launches import launch
from warpqem.runtime.staging import Uploads

__all__ = ["BoundsMeter", "DeviceSink", "HeldFrames", "device_blocks", "take_vertices", "to_device"]


def to_device(points: np.ndarray | wp.array, device: str) -> wp.array:
    """Points (n, V, 3) float32 as an array (n, V) of the device, maybe a view of them; or those there already."""
    if isinstance(points, wp.array):
        return points
    return new_arrays.uploaded(points, dtype=wp.vec3, device=device, copy=False)


def take_vertices(points: wp.array, vertex: wp.array) -> wp.array:
    """Some vertices (M,) int32 of points (n, V): (n, M) points."""
    taken = wp.empty((len(points), len(vertex)), dtype=points.dtype, device=points.device)
    wp.copy(taken, wp.indexedarray(points, [None, vertex]))
    return taken


@dataclass(frozen=True)
class HeldFrames:
    """All frames of a mesh, about its origin, on the device, so that each is brought there once.

    Attributes:
        points: (F, V) points.
    """

    points: wp.array

    @classmethod
    def empty(cls, frame_count: int, vertex_count: int, device: str) -> HeldFrames:
        """Room for the frames."""
        return cls(wp.empty((frame_count, vertex_count), dtype=wp.vec3, device=device))

    def put(self, frames: slice, points: np.ndarray) -> wp.array:
        """Bring consecutive frames (n, V, 3) float32 there: (n, V) points on the device."""
        block = self.block(frames)
        wp.copy(block, to_device(points, "cpu"))
        return block

    def block(self, frames: slice) -> wp.array:
        """Consecutive frames, (n, V) points."""
        return self.points[frames.start : frames.stop]


def device_blocks(
    held: HeldFrames | None, read: Callable[[slice], np.ndarray], blocks: Sequence[slice], device: str
) -> Iterator[tuple[slice, wp.array]]:
    """Every block of frames on the device, (n, V) points: those held there, or else what ``read`` gives, as float32.

    Where they are copied there, the next block is on its way while the caller's work on one is done, which has to be
    begun when the next one is asked for: it takes the place of that before.
    """
    if held is not None:
        for frames in blocks:
            yield frames, held.block(frames)
    elif len(blocks) < 2 or not device_traits(device).own_memory:
        # Nothing is done while a single block travels.
        for frames, points in read_ahead(read, blocks):
            yield frames, to_device(points, device)
    else:
        with contextlib.closing(Uploads(device)) as uploads:
            for frames, staged in read_ahead(uploads.staged(read), blocks):
                yield frames, uploads.sent(staged)


class BoundsMeter:
    """Measures blocks of frames: there, on a device with memory of its own, else with NumPy, in a quarter of the time.

    Args:
        used: (V,) bool, the vertices that count.
        device: Warp device.
    """

    def __init__(self, used: np.ndarray, device: str) -> None:
        self._device, self._on_device = device, device_traits(device).own_memory
        self._used = None if used.all() else used
        # An empty array stands for all vertices.
        flags = used[:0] if self._used is None else used
        self._flags = wp.array(flags, dtype=wp.bool, device=device) if self._on_device else None

    def measure(
        self, points: np.ndarray, held: HeldFrames | None, frames: slice
    ) -> tuple[np.ndarray, np.ndarray, bool]:
        """Measure consecutive frames, and bring them to ``held`` where there is one.

        Args:
            points: (n, V, 3) float32.
            held: takes them.
            frames: which they are.

        Returns:
            Lowest and highest corner of each frame, (n, 3) float32, and whether all points are finite.
        """
        block = None if held is None else held.put(frames, points)
        if self._on_device:
            return self.measure_there(to_device(points, self._device) if block is None else block)
        low, high = frame_bounds(points)
        finite = bool(np.isfinite(low).all() and np.isfinite(high).all())
        if self._used is not None:
            low, high = frame_bounds(points[:, self._used])
        return low, high, finite

    def measure_there(self, points: wp.array) -> tuple[np.ndarray, np.ndarray, bool]:
        """The same of points (n, V) on the device, which has memory of its own."""
        found = self.bounds_there(points).numpy()
        return found[:, :3], found[:, 3:6], not found[:, 6].any()

    def bounds_there(self, points: wp.array) -> wp.array:
        """The same on the device, (n, 7) float32: lowest corner, highest corner, 1 where a point is not finite."""
        largest = float(kernels.LARGEST)
        initial = np.array([[*3 * [largest], *3 * [-largest], 0.0]], dtype=np.float32)
        count, vertex_count = points.shape
        bounds = wp.array(np.repeat(initial, count, axis=0), dtype=wp.float32, device=self._device)
        lanes = max(1, min(device_traits(self._device).launch_threads // count, vertex_count))
        inputs = [points, self._flags, lanes]
        launch(kernels.measure_bounds, (count, lanes), inputs, [bounds], device=self._device)
        return bounds


class DeviceSink:
    """Keeps the frames of a result in an array on the device.

    Args:
        device: Warp device.

    Attributes:
        points: (F, V') points.
    """

    points: wp.array

    def __init__(self, device: str) -> None:
        self._device = device

    def begin(self, frame_count: int, vertex_count: int, faces: np.ndarray) -> None:
        """Make room for all frames."""
        self.points = wp.empty((frame_count, vertex_count), dtype=wp.vec3, device=self._device)

    def room(self, frames: slice) -> wp.array:
        """Where consecutive frames belong, (n, V') points, for what is on the device already."""
        return self.points[frames.start : frames.stop]

    def write(self, frames: slice, points: np.ndarray) -> None:
        """Take frames from the host."""
        wp.copy(self.room(frames), to_device(points, "cpu"))
