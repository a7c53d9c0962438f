"""Sources and sinks of frames from callers: checked at once, and every block of frames when it is read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from warpqem.arguments.array_input import FLOAT32_MAX, INDEX_LIMIT, as_numpy
from warpqem.arguments.number_input import shown, whole_number
from warpqem.errors import DegenerateMeshError, FrameSourceError, MeshShapeError, NonFinitePointError, OptionError
from warpqem.frames.stream import FrameSource, counted_frames, held_bytes

__all__ = ["BrokenPoints", "CheckedFrames", "check_sink", "check_source", "frame_bounds"]

# What a source has, see :class:`warpqem.FrameSource`.
SOURCE_NAMES = ("frame_count", "vertex_count", "dtype", "read")
SINK_NAMES = ("begin", "write")


def check_source(source: Any, name: str) -> CheckedFrames | None:
    """A caller's source of frames with its counts and dtype checked; None for what is no source but may be an array.

    Args:
        source: the argument.
        name: what messages call it.

    Raises:
        FrameSourceError: it lacks something that a source has, or that is not what it should be.
        DegenerateMeshError: it has no frame or no vertex.
    """
    if isinstance(source, CheckedFrames):
        return source
    missing = [part for part in SOURCE_NAMES if not hasattr(source, part)]
    if "read" in missing or (missing and hasattr(source, "__array_interface__")):
        return None
    kind = type(source).__name__
    if missing:
        raise FrameSourceError(f"{name}: a {kind} has read, but no {' and no '.join(missing)}, as a frame source has")
    if isinstance(source, type):
        raise FrameSourceError(
            f"{name}: the class {source.__name__} was given, expected an instance: {source.__name__}()"
        )
    if not callable(source.read):
        raise FrameSourceError(f"{name}.read must be a method that gives frames, got {shown(source.read)}")
    return CheckedFrames(source, name)


class CheckedFrames:
    """The frames of a caller's source, which may be anything.

    Every block is checked for its shape and dtype and copied, as a source may use one buffer for all of them while a
    block is at work and the next one is read. A frame that is read again must have the bounds it had at first: results
    are put together from several readings.

    Args:
        source: the caller's.
        name: what messages call it.

    Attributes:
        held_bytes: what the source keeps in memory.
        counted: (F,) bool, frames that count, see :func:`warpqem.frames.stream.counted_frames`.
    """

    def __init__(self, source: FrameSource, name: str) -> None:
        self._source, self._name = source, name
        self.frame_count = self._count("frame_count")
        self.vertex_count = self._count("vertex_count")
        if self.frame_count < 1 or self.vertex_count < 1:
            raise DegenerateMeshError(f"{name} are empty: {self.frame_count} frames of {self.vertex_count} vertices")
        if self.vertex_count > INDEX_LIMIT:
            raise MeshShapeError(f"{name} have {self.vertex_count} vertices, more than the {INDEX_LIMIT} that can be")
        self.dtype = self._float_type()
        self.held_bytes, self.counted = held_bytes(source), counted_frames(source)
        self._bounds: np.ndarray | None = None
        self._seen = np.zeros(self.frame_count, dtype=bool)

    def _count(self, part: str) -> int:
        value = getattr(self._source, part)
        try:
            return whole_number(value, f"{self._name}.{part}", least=-(2**63), expected="a whole number")
        except OptionError as error:
            raise FrameSourceError(str(error)) from None

    def _float_type(self) -> np.dtype[Any]:
        given = self._source.dtype
        try:
            found = np.dtype(given)
        except TypeError:
            found = np.dtype(object)
        if given is None or found.kind != "f" or found.itemsize not in (4, 8):
            raise FrameSourceError(f"{self._name} must be float32 or float64, got a source of {given}")
        return found.newbyteorder("=")

    def read(self, frames: slice) -> np.ndarray:
        """Consecutive frames (n, V, 3), as an array that belongs to the reader.

        Raises:
            FrameSourceError: the source gives no array, or one of another shape or dtype, or frames that are not those
                it gave before.
            NonFinitePointError: a point that was finite when it was read first is not any more.
            Exception: what the source raises, as it is.
        """
        name = f"{self._name}.read of frames {frames.start} to {frames.stop - 1}"
        given = self._source.read(frames)
        try:
            points = as_numpy(given, name)
        except MeshShapeError as error:
            raise FrameSourceError(str(error)) from error
        wanted = (frames.stop - frames.start, self.vertex_count, 3)
        if points.shape != wanted:
            raise FrameSourceError(f"{name}: expected shape {wanted}, got {points.shape}")
        if points.dtype.newbyteorder("=") != self.dtype:
            raise FrameSourceError(f"{name}: expected {self.dtype}, as {self._name}.dtype says, got {points.dtype}")
        points = np.array(points, dtype=self.dtype, order="C", copy=True)
        self._compare(frames, points)
        return points

    def _compare(self, frames: slice, points: np.ndarray) -> None:
        """Compare with what was read before. What is not finite at first, its reader finds."""
        if self._bounds is None:
            self._bounds = np.empty((2, self.frame_count, 3), dtype=self.dtype)
        bounds, before = np.stack(frame_bounds(points)), self._bounds[:, frames]
        seen = self._seen[frames]
        changed = np.flatnonzero(seen & ~((bounds == before) | np.isnan(before)).all(axis=(0, 2)))
        if len(changed):
            first = int(changed[0])
            broken = BrokenPoints.add(None, points[first : first + 1], frames.start + first)
            if broken is not None:
                raise NonFinitePointError(
                    f"point of {broken.text}, which was finite when {self._name} were read first: a source must give "
                    "the same frames every time"
                )
            low, high = (f"({', '.join(f'{x:g}' for x in corner)})" for corner in bounds[:, first])
            was = " to ".join(f"({', '.join(f'{x:g}' for x in corner)})" for corner in before[:, first])
            raise FrameSourceError(
                f"{self._name}: frame {frames.start + first} lies within {low} to {high}, and within {was} when it was "
                "read first: a source must give the same frames every time"
            )
        before[:, ~seen] = bounds[:, ~seen]
        seen[:] = True


def check_sink(sink: Any) -> None:
    """Check that a sink has what frames are handed to, before there are any.

    Raises:
        OptionError: it is not None and lacks a method.
    """
    if sink is None:
        return
    if isinstance(sink, type):
        raise OptionError(f"sink: the class {sink.__name__} was given, expected an instance: {sink.__name__}()")
    missing = [name for name in SINK_NAMES if not callable(getattr(sink, name, None))]
    if missing:
        raise OptionError(f"sink: {shown(sink)} has no method {' and no method '.join(missing)}, as a frame sink has")


def frame_bounds(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corner (F, 3) of each frame; NaN and infinity come through.

    Vertices are taken 64 at a time, so that NumPy reduces long contiguous rows instead of rows of three.
    """
    frame_count, vertex_count, _ = points.shape
    whole = vertex_count - vertex_count % 64
    rows = points[:, :whole].reshape(frame_count, -1, 192)
    rest = points[:, whole:]
    bounds = []
    for reduce in (np.min, np.max):
        parts = [reduce(rest, axis=1)] if whole < vertex_count else []
        if whole:
            parts.append(reduce(reduce(rows, axis=1).reshape(frame_count, 64, 3), axis=1))
        bounds.append(reduce(np.stack(parts), axis=0))
    return bounds[0], bounds[1]


@dataclass(frozen=True)
class BrokenPoints:
    """The first point that is no point, and how many there are."""

    text: str
    count: int

    @classmethod
    def add(cls, before: BrokenPoints | None, points: np.ndarray, first_frame: int) -> BrokenPoints | None:
        """Count those of consecutive frames (n, V, 3) too; None where there are none, nor were before."""
        bad = ~(np.abs(points) <= FLOAT32_MAX)
        count = int(bad.any(axis=2).sum())
        if not count:
            return before
        if before is not None:
            return cls(before.text, before.count + count)
        frame, vertex, axis = np.argwhere(bad)[0]
        where = f"vertex {vertex} in frame {first_frame + frame}"
        return cls(f"{where} has {'xyz'[axis]} = {points[frame, vertex, axis]}", count)

    def error(self, prefix: str = "point of") -> NonFinitePointError:
        """What to raise."""
        return NonFinitePointError(f"{prefix} {self.text} ({self.count} such points in all)")
