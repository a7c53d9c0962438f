"""Frames as a stream: where they come from, where they go, and blocks of them on the way.

A mesh in motion may have more frames than fit in memory. So they are read from a :class:`FrameSource` and written to a
:class:`FrameSink`, a block at a time; arrays are one kind of both. While one block is at work, the next one is read and
the one before is written, each on a thread of its own.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Generic, Protocol, TypeVar, runtime_checkable

import numpy as np

from warpqem.runtime.device import turns_released

__all__ = [
    "ArrayFrames",
    "ArraySink",
    "FrameSink",
    "FrameSource",
    "FrameWriter",
    "JoinedFrames",
    "KeptFrames",
    "LaterFrames",
    "NoFrames",
    "SharedFrames",
    "SomeFrames",
    "counted_frames",
    "held_bytes",
    "read_ahead",
]

Block = TypeVar("Block")


@runtime_checkable
class FrameSource(Protocol):
    """Frames of one mesh, to be read as often as they are needed.

    Attributes:
        frame_count: frames F, at least 1.
        vertex_count: vertices V.
        dtype: float32 or float64, of the points.
    """

    @property
    def frame_count(self) -> int:
        """Frames F."""
        ...

    @property
    def dtype(self) -> np.dtype:
        """Type of the points."""
        ...

    @property
    def vertex_count(self) -> int:
        """Vertices V."""
        ...

    def read(self, frames: slice) -> np.ndarray:
        """Points (n, V, 3) of consecutive frames, the same on every call.

        It is called from one thread at a time, not always the same one. The array is not written to.
        """
        ...


class FrameSink(Protocol):
    """Takes the frames of the simplified mesh."""

    def begin(self, frame_count: int, vertex_count: int, faces: np.ndarray) -> None:
        """Called once, before the first block: F frames of V' vertices and the faces (N', 3) int32."""
        ...

    def write(self, frames: slice, points: np.ndarray) -> None:
        """Take points (n, V', 3) float32 of consecutive frames; called in the order of the frames, on one thread."""
        ...


class ArrayFrames:
    """The frames of an array.

    Args:
        points: (F, V, 3) real numbers. Blocks are float32 where they are, in either byte order, else float64.
    """

    def __init__(self, points: np.ndarray) -> None:
        self._points = points
        is_single = points.dtype.kind == "f" and points.dtype.itemsize == 4
        self.frame_count, self.vertex_count = points.shape[:2]
        self.dtype = np.dtype(np.float32 if is_single else np.float64)

    def read(self, frames: slice) -> np.ndarray:
        """A view of the frames, or a copy where their type is another."""
        return self._points[frames].astype(self.dtype, copy=False)


class JoinedFrames:
    """Frames of several sources, one after the other.

    Args:
        parts: sources of the same vertices, at least one.
    """

    def __init__(self, parts: Sequence[FrameSource]) -> None:
        self._parts = [part for part in parts if part.frame_count] or list(parts[:1])

    @property
    def frame_count(self) -> int:
        """Frames F."""
        return sum(part.frame_count for part in self._parts)

    @property
    def vertex_count(self) -> int:
        """Vertices V."""
        return self._parts[0].vertex_count

    @property
    def dtype(self) -> np.dtype:
        """Type of the points."""
        return self._parts[0].dtype

    @property
    def held_bytes(self) -> int:
        """What its parts keep in memory."""
        return sum(held_bytes(part) for part in self._parts)

    @property
    def counted(self) -> np.ndarray:
        """Frames that count."""
        return np.concatenate([counted_frames(part) for part in self._parts])

    def read(self, frames: slice) -> np.ndarray:
        """Consecutive frames, of as many parts as they lie in."""
        blocks, first = [], 0
        for part in self._parts:
            start, stop = max(frames.start - first, 0), min(frames.stop - first, part.frame_count)
            if start < stop:
                blocks.append(part.read(slice(start, stop)))
            first += part.frame_count
        return blocks[0] if len(blocks) == 1 else np.concatenate(blocks)


class SomeFrames:
    """Consecutive frames of another source.

    Args:
        source: all frames.
        start: the first one.
        stop: the one after the last.
    """

    def __init__(self, source: FrameSource, start: int, stop: int) -> None:
        self._source, self._start = source, start
        self.frame_count, self.vertex_count, self.dtype = stop - start, source.vertex_count, source.dtype
        self.counted = counted_frames(source)[start:stop]

    def read(self, frames: slice) -> np.ndarray:
        """Frames counted from the first one here."""
        return self._source.read(slice(self._start + frames.start, self._start + frames.stop))


class KeptFrames:
    """Frames that are read once and kept, for sources that are slow and small.

    Args:
        source: the frames.

    Attributes:
        held_bytes: what they take, which a memory plan counts.
    """

    def __init__(self, source: FrameSource) -> None:
        self._source = source
        self.frame_count, self.vertex_count, self.dtype = source.frame_count, source.vertex_count, source.dtype
        self.held_bytes = 3 * self.dtype.itemsize * self.frame_count * self.vertex_count
        self.counted = counted_frames(source)
        self._points: np.ndarray | None = None

    def read(self, frames: slice) -> np.ndarray:
        """A view of the frames."""
        if self._points is None:
            self._points = self._source.read(slice(0, self.frame_count))
        return self._points[frames]


class SharedFrames:
    """Frames that several threads read, one at a time.

    Args:
        source: the frames.
    """

    def __init__(self, source: FrameSource) -> None:
        self._source, self._reading = source, threading.Lock()
        self.frame_count, self.vertex_count, self.dtype = source.frame_count, source.vertex_count, source.dtype
        self.held_bytes, self.counted = held_bytes(source), counted_frames(source)

    def read(self, frames: slice) -> np.ndarray:
        """Consecutive frames."""
        # Whoever is reading may wait for a turn that this thread has.
        with turns_released(), self._reading:
            return self._source.read(frames)


def counted_frames(source: FrameSource) -> np.ndarray:
    """(F,) bool, frames that count in the order and in errors: all, unless the source has a ``counted`` of its own.

    Frames in which nobody sees the mesh are placed like the others, and decide nothing. At least one counts.
    """
    counted = getattr(source, "counted", None)
    everywhere = np.ones(source.frame_count, dtype=bool)
    return everywhere if counted is None or not np.any(counted) else np.asarray(counted, dtype=bool)


def held_bytes(source: FrameSource) -> int:
    """Bytes that a source is going to keep in memory, 0 for one that does not say."""
    return int(getattr(source, "held_bytes", 0))


class ArraySink:
    """Keeps the frames in an array.

    Attributes:
        points: (F, V', 3) float32.
    """

    points: np.ndarray

    def begin(self, frame_count: int, vertex_count: int, faces: np.ndarray) -> None:
        """Make room for all frames."""
        self.points = np.empty((frame_count, vertex_count, 3), dtype=np.float32)

    def write(self, frames: slice, points: np.ndarray) -> None:
        """Copy the frames."""
        self.points[frames] = points


class LaterFrames:
    """Passes on all frames but the first ones.

    Args:
        sink: takes the others.
        skipped: how many frames it does not get to see.
    """

    def __init__(self, sink: FrameSink, skipped: int) -> None:
        self._sink, self._skipped = sink, skipped

    def begin(self, frame_count: int, vertex_count: int, faces: np.ndarray) -> None:
        """Announce the frames but those skipped."""
        self._sink.begin(frame_count - self._skipped, vertex_count, faces)

    def write(self, frames: slice, points: np.ndarray) -> None:
        """Pass on what is not skipped, numbered from nought."""
        start = max(frames.start, self._skipped)
        if start < frames.stop:
            self._sink.write(slice(start - self._skipped, frames.stop - self._skipped), points[start - frames.start :])


class NoFrames:
    """Takes frames that nobody needs."""

    def begin(self, frame_count: int, vertex_count: int, faces: np.ndarray) -> None:
        """Nothing to do."""

    def write(self, frames: slice, points: np.ndarray) -> None:
        """Nothing to do."""


def read_ahead(read: Callable[[slice], Block], blocks: Sequence[slice]) -> Iterator[tuple[slice, Block]]:
    """Every block with what ``read`` gives for it; the next one is read on a thread while the caller is at work."""
    if len(blocks) < 2:
        for frames in blocks:
            with turns_released():
                block = read(frames)
            yield frames, block
        return
    pool = ThreadPoolExecutor(1, thread_name_prefix="warpqem-read")
    try:
        pending = pool.submit(read, blocks[0])
        for frames, following in zip(blocks, [*blocks[1:], None], strict=True):
            with turns_released():
                block = pending.result()
            if following is not None:
                pending = pool.submit(read, following)
            yield frames, block
            # The caller is done with it: two blocks are enough in memory.
            del block
    finally:
        # A block under way may wait for its turn.
        with turns_released():
            pool.shutdown(wait=True)


class FrameWriter(Generic[Block]):
    """Writes blocks on a thread, in order; used with ``with``, whose end waits for the last one.

    Args:
        write: takes the frames of a block and the block. Its error is raised at the next call, or at the end.
        block_count: blocks there are going to be; a single one is written without a thread.
    """

    def __init__(self, write: Callable[[slice, Block], None], block_count: int) -> None:
        self._write = write
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="warpqem-write") if block_count > 1 else None
        self._pending: Future[None] | None = None

    def __call__(self, frames: slice, block: Block) -> None:
        """Write a block as soon as the one before is written; until then this call waits."""
        if self._pool is None:
            with turns_released():
                self._write(frames, block)
            return
        self._wait()
        self._pending = self._pool.submit(self._write, frames, block)

    def _wait(self) -> None:
        pending, self._pending = self._pending, None
        if pending is not None:
            with turns_released():
                pending.result()

    def __enter__(self) -> FrameWriter[Block]:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            # Where the caller has failed, that error counts, and the block under way is only waited for.
            if error is None:
                self._wait()
        finally:
            if self._pool is not None:
                with turns_released():
                    self._pool.shutdown(wait=True)
