"""Frames that the caller has on a device already: they stay there."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import warp as wp

from warpqem.frames.device_frames import take_vertices
from warpqem.kernels import frame_origin as kernels
from warpqem.runtime.device import device_turn
from warpqem.runtime.launches import launch

__all__ = ["DeviceFrames"]


class DeviceFrames:
    """The frames of an array on a device, a source whose frames the host need not read.

    Args:
        points: (F, V, 3) real numbers, in any layout.
        vertex: (V',) int32 on the device, which of its vertices each vertex is; None for all in their order.

    Attributes:
        device: name of the Warp device.
        frame_count: frames F.
        vertex_count: vertices V, or V'.
        dtype: what blocks on the host are: float32 where the array is, else float64.
    """

    def __init__(self, points: wp.array, vertex: wp.array | None = None) -> None:
        self._points, self._vertex = points, vertex
        self.device: str = points.device.alias
        self.frame_count: int = points.shape[0]
        self.vertex_count: int = points.shape[1] if vertex is None else len(vertex)
        self.dtype = np.dtype(np.float32 if points.dtype is wp.float32 else np.float64)

    def split(self, vertex: np.ndarray) -> DeviceFrames:
        """The same frames with some vertices more than once: (V',) which of the array's each is."""
        return DeviceFrames(self._points, wp.array(vertex, dtype=wp.int32, device=self.device))

    def read(self, frames: slice) -> np.ndarray:
        """Consecutive frames (n, V, 3) on the host, for what works there; from any thread, in a turn of the device."""
        with device_turn(self.device):
            found: np.ndarray = self._taken(frames).numpy()
        return found

    @cached_property
    def whole(self) -> wp.array | None:
        """All frames, (F, V) points in the memory of the caller; None where they need to be converted."""
        if self._vertex is not None or self._points.dtype is not wp.float32 or self._points.strides[2] != 4:
            return None
        return self._points.view(wp.vec3)

    def first_origin(self, used: np.ndarray) -> np.ndarray:
        """The origin (3,) that points in double precision are taken about: the middle of some vertices at first.

        It has the bits that it has for an array on the host. So the first frame of such points is read there; points in
        single precision have none, and are not read.
        """
        if self.dtype == np.float32:
            return np.zeros(3)
        with np.errstate(invalid="ignore", over="ignore"):
            return np.asarray(self.read(slice(0, 1))[0, used].mean(axis=0))

    def block(self, frames: slice, origin: np.ndarray, out: wp.array | None = None) -> wp.array:
        """Consecutive frames about ``origin``, (n, V) points, in ``out`` if that is given.

        Points in single precision come as they are. Of others, those that are not finite in it are NaN.
        """
        if self.whole is not None:
            return self.whole[frames.start : frames.stop]
        taken = self._taken(frames)
        if out is None:
            out = wp.empty(taken.shape[:2], dtype=wp.vec3, device=self.device)
        if taken.dtype is wp.vec3:
            wp.copy(out, taken)
        else:
            offset = wp.vec3d(*map(float, origin))
            launch(kernels.subtract_origin, out.shape, [taken, offset], [out], device=self.device)
        return out

    def chosen(self, frames: np.ndarray, origin: np.ndarray) -> wp.array:
        """Some frames (K,) about ``origin``, (K, V) points."""
        out = wp.empty((len(frames), self.vertex_count), dtype=wp.vec3, device=self.device)
        for row, frame in enumerate(frames.tolist()):
            room = out[row : row + 1]
            block = self.block(slice(frame, frame + 1), origin, room)
            if self.whole is not None:
                wp.copy(room, block)
        return out

    def _taken(self, frames: slice) -> wp.array:
        """Consecutive frames, (n, V) points in single or double precision."""
        part = self._points[frames.start : frames.stop]
        if part.dtype not in (wp.float32, wp.float64):
            single = part.contiguous()
            part = wp.empty(part.shape, dtype=wp.float64, device=self.device)
            wp.utils.array_cast(single, part)
        itemsize = wp.types.type_size_in_bytes(part.dtype)
        if part.strides[2] != itemsize:
            part = part.contiguous()
        points = part.view(wp.vec3 if part.dtype is wp.float32 else wp.vec3d)
        return points if self._vertex is None else take_vertices(points, self._vertex)
