"""Placed frames kept between two passes over them, in memory, in a temporary file or on the device."""

from __future__ import annotations

import tempfile

import numpy as np
import warp as wp

from warpqem.place.block_placer import PlacedFrames

__all__ = ["AnyFrameStore", "DeviceFrameStore", "FrameStore"]


class FrameStore:
    """All frames that :meth:`Placer.place` gave.

    Args:
        frame_count: frames F.
        vertex_count: output vertices C.
        copied_count: vertices M that are copied from the input.
        on_disk: keep them in a file without a name, in the folder for temporary files, instead of in memory.
    """

    def __init__(self, frame_count: int, vertex_count: int, copied_count: int, on_disk: bool) -> None:
        self.frame_count, self.vertex_count = frame_count, vertex_count
        self._row = (2 * vertex_count + copied_count, 3)
        self._file = tempfile.TemporaryFile(prefix="warpqem-") if on_disk else None  # noqa: SIM115
        self._rows = np.empty((0 if on_disk else frame_count, *self._row), dtype=np.float32)

    def write(self, frames: slice, placed: PlacedFrames) -> None:
        """Keep consecutive frames."""
        rows = placed.to_rows()
        if self._file is None:
            self._rows[frames] = rows
            return
        self._file.seek(frames.start * rows[0].nbytes)
        self._file.write(rows.data)

    def read(self, frames: slice) -> PlacedFrames:
        """Consecutive frames."""
        if self._file is None:
            rows = self._rows[frames]
        else:
            values = self._row[0] * self._row[1]
            self._file.seek(4 * values * frames.start)
            rows = np.frombuffer(self._file.read(4 * values * (frames.stop - frames.start)), dtype=np.float32)
            rows = rows.reshape(-1, *self._row)
        return PlacedFrames.from_rows(rows, self.vertex_count)

    def chosen(self, frames: np.ndarray) -> PlacedFrames:
        """Any frames."""
        blocks = [self.read(slice(frame, frame + 1)) for frame in frames.tolist()]
        return PlacedFrames(
            np.concatenate([block.points for block in blocks]),
            np.concatenate([block.normals for block in blocks]),
            np.concatenate([block.copied for block in blocks]),
        )

    def close(self) -> None:
        """Let go of the memory or the file."""
        self._rows = self._rows[:0].copy()
        if self._file is not None:
            self._file.close()


class DeviceFrameStore:
    """The same on a device with memory of its own: what is read stays there.

    Args:
        frame_count: frames F.
        vertex_count: output vertices C.
        copied_count: vertices M that are copied from the input.
        device: Warp device.
    """

    def __init__(self, frame_count: int, vertex_count: int, copied_count: int, device: str) -> None:
        self.frame_count, self.vertex_count = frame_count, vertex_count
        self._rows = wp.empty((frame_count, 2 * vertex_count + copied_count), dtype=wp.vec3, device=device)

    def room(self, frames: slice) -> wp.array:
        """Where consecutive frames belong, (n, 2C + M) points, see :meth:`PlacedBlocks.fill`."""
        return self._rows[frames.start : frames.stop]

    def read(self, frames: slice) -> PlacedFrames:
        """Consecutive frames."""
        return self._views(self.room(frames))

    def chosen(self, frames: np.ndarray) -> PlacedFrames:
        """Any frames."""
        index = wp.array(frames, dtype=wp.int32, device=self._rows.device)
        return self._views(wp.indexedarray(self._rows, [index]).contiguous())

    def _views(self, rows: wp.array) -> PlacedFrames:
        count = self.vertex_count
        # Warp has no empty slices.
        copied = rows[:, 2 * count :] if rows.shape[1] > 2 * count else self._none(len(rows))
        return PlacedFrames(rows[:, :count], rows[:, count : 2 * count], copied)

    def _none(self, frame_count: int) -> wp.array:
        return wp.empty((frame_count, 0), dtype=wp.vec3, device=self._rows.device)


AnyFrameStore = FrameStore | DeviceFrameStore
