"""Blocks that travel between the host and a device while the device works on others.

A copy from or to memory that the system may move makes the host wait until it is done. So blocks go by way of buffers
in pinned memory, on a stream of copies beside that of the work, and events keep the two in order:

- a buffer on the host is filled again when the copy from it is done;
- a copy to the device begins when the work on what was there before is done, and work on it when the copy is;
- a copy to the host begins when the work that makes the block is done, and the block is kept until it is through.

On a device without streams each copy is made at once. No GPU has measured what this gains.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import warp as wp

__all__ = ["CopyStream", "Download", "Downloads", "HostBuffer", "Staged", "Uploads", "copy_stream", "work_copies"]

# Blocks under way: one that is filled, or written, while another one travels; and one more, so that the thread that has
# the device's turn waits for copies, and not the one that reads or writes: another call may capture a graph meanwhile.
BUFFERS = 3
# Blocks on the device: one that is worked on while another one comes.
BLOCKS_THERE = 2


@dataclass(frozen=True)
class HostBuffer:
    """Memory on the host that a device copies from and to.

    Attributes:
        array: (n,) float32 as Warp sees it.
        numbers: the same for NumPy.
    """

    array: wp.array
    numbers: np.ndarray

    @classmethod
    def empty(cls, size: int, pinned: bool) -> HostBuffer:
        """Room for so many numbers, one at least."""
        if not pinned:
            numbers = np.empty(size, dtype=np.float32)
            return cls(wp.array(ptr=numbers.ctypes.data, dtype=wp.float32, shape=(size,), device="cpu"), numbers)
        array = wp.empty(size, dtype=wp.float32, device="cpu", pinned=True)
        return cls(array, np.ctypeslib.as_array((ctypes.c_float * size).from_address(array.ptr)))


class CopyStream(Protocol):
    """Copies of a device beside its work. What marks a place in either may be anything."""

    def buffer(self, size: int) -> HostBuffer:
        """Memory that copies come from and go to, for so many numbers."""
        ...

    def mark(self) -> Any:
        """The work of the device that was begun before."""
        ...

    def copy(self, target: wp.array, source: wp.array, after: Any) -> Any:
        """Begin a copy when marked work is done; what marks the copy."""
        ...

    def work_after(self, copied: Any) -> None:
        """Let work from now on begin when a copy is done."""
        ...

    def wait(self, copied: Any) -> None:
        """Return when a copy is done."""
        ...


class CudaCopies:
    """Copies on a stream of their own.

    Args:
        device: a GPU.
    """

    def __init__(self, device: wp.Device) -> None:
        self._device, self._stream = device, wp.Stream(device)

    def buffer(self, size: int) -> HostBuffer:
        """Pinned memory."""
        return HostBuffer.empty(size, pinned=True)

    def mark(self) -> wp.Event:
        """An event of the stream of the work."""
        event: wp.Event = self._device.stream.record_event()
        return event

    def copy(self, target: wp.array, source: wp.array, after: wp.Event) -> wp.Event:
        """A copy on the other stream."""
        self._stream.wait_event(after)
        wp.copy(target, source, stream=self._stream)
        copied: wp.Event = self._stream.record_event()
        return copied

    def work_after(self, copied: wp.Event) -> None:
        """The host does not wait."""
        self._device.stream.wait_event(copied)

    def wait(self, copied: wp.Event) -> None:
        """The host does."""
        wp.synchronize_event(copied)


class PlainCopies:
    """Copies that are done at once, on a device without streams."""

    def buffer(self, size: int) -> HostBuffer:
        """Any memory."""
        return HostBuffer.empty(size, pinned=False)

    def mark(self) -> None:
        """All is done."""

    def copy(self, target: wp.array, source: wp.array, after: None) -> None:
        """A copy."""
        wp.copy(target, source)

    def work_after(self, copied: None) -> None:
        """It is done."""

    def wait(self, copied: None) -> None:
        """It is done."""


def copy_stream(device: str) -> CopyStream:
    """What copies for a device."""
    there = wp.get_device(device)
    return CudaCopies(there) if there.is_cuda else PlainCopies()


def work_copies(device: str, block_count: int) -> CopyStream:
    """The same for so many blocks: nothing is done while a single one travels."""
    return copy_stream(device) if block_count > 1 else PlainCopies()


class _Buffer:
    """A buffer on the host that grows with what is put there, and the copy from or to it that is under way."""

    def __init__(self, stream: CopyStream) -> None:
        self._stream = stream
        self._memory: HostBuffer | None = None
        self._copied: list[Any] = []

    def room(self, size: int) -> HostBuffer:
        """Room for so many numbers at least; the copy is done."""
        assert not self._copied, "a buffer is filled while it is copied"
        if self._memory is None or len(self._memory.numbers) < size:
            self._memory = self._stream.buffer(max(1, size))
        return self._memory

    def send(self, size: int, target: wp.array, after: Any) -> Any:
        """Copy the first numbers to a device."""
        assert self._memory is not None
        copied = self._stream.copy(target, self._memory.array[:size], after)
        self._copied.append(copied)
        return copied

    def wait(self) -> None:
        """Return when the copy is done."""
        while self._copied:
            self._stream.wait(self._copied.pop())


@dataclass(frozen=True)
class Staged:
    """A block that is ready to go to the device.

    Attributes:
        points: (n, V, 3), as it was read.
        buffer: holds the same; None where points are not float32.
    """

    points: np.ndarray
    buffer: _Buffer | None


class Uploads:
    """Brings blocks of points to a device, one after another.

    Args:
        device: Warp device.
        stream: what copies; None for that of the device.
    """

    def __init__(self, device: str, stream: CopyStream | None = None) -> None:
        self._device = device
        self._stream = copy_stream(device) if stream is None else stream
        self._buffers = [_Buffer(self._stream) for _ in range(BUFFERS)]
        self._read = 0
        # Where blocks lie on the device that nobody keeps, and the work on each.
        self._there: list[wp.array | None] = [None] * BLOCKS_THERE
        self._worked: list[Any] = [None] * BLOCKS_THERE
        self._before: _Buffer | None = None
        self._sent = 0

    def staged(self, read: Callable[[slice], np.ndarray]) -> Callable[[slice], Staged]:
        """What reads blocks and makes them ready, one at a time, from any thread.

        A block is to be sent before the next but one is read.
        """

        def ready(frames: slice) -> Staged:
            points = read(frames)
            if points.dtype != np.float32:
                return Staged(points, None)
            buffer = self._buffers[self._read % BUFFERS]
            self._read += 1
            buffer.room(points.size).numbers[: points.size] = points.reshape(-1)
            return Staged(points, buffer)

        return ready

    def send(self, block: Staged, target: wp.array) -> None:
        """Bring a block to (n, V) points on the device that no work has used; work from now on finds it there."""
        self._send(block, target, self._stream.mark())

    def sent(self, block: Staged) -> wp.array:
        """(n, V) points on the device, to be worked on until the next block is sent."""
        slot = self._sent % BLOCKS_THERE
        # Work on the block before was begun.
        self._worked[slot - 1] = self._stream.mark()
        self._sent += 1
        frame_count, vertex_count = block.points.shape[:2]
        there, after = self._there[slot], self._worked[slot]
        if there is None or there.shape[1] != vertex_count or len(there) < frame_count:
            there = self._there[slot] = wp.empty((frame_count, vertex_count), dtype=wp.vec3, device=self._device)
            after = self._stream.mark()
        target = there if len(there) == frame_count else there[:frame_count]
        self._send(block, target, after)
        return target

    def _send(self, block: Staged, target: wp.array, after: Any) -> None:
        assert block.buffer is not None
        size = block.points.size
        # The same memory as numbers.
        numbers = wp.array(ptr=target.ptr, dtype=wp.float32, shape=(size,), device=target.device)
        self._stream.work_after(block.buffer.send(size, numbers, after))
        # The block before has mostly arrived; the next but one takes its buffer.
        if self._before is not None:
            self._before.wait()
        self._before = block.buffer

    def close(self) -> None:
        """Return when no buffer is read from any more."""
        for buffer in self._buffers:
            buffer.wait()


class Download:
    """A block on its way to the host.

    Args:
        wait: returns when it is there; to be called by the thread that has the device's turn.
        result: gives its numbers (n,) float32 then, once, which belong to the caller; from any thread.
    """

    def __init__(self, wait: Callable[[], None], result: Callable[[], np.ndarray]) -> None:
        self.wait, self.result = wait, result

    @classmethod
    def of(cls, numbers: np.ndarray) -> Download:
        """Numbers (n,) float32 that are there."""
        return cls(lambda: None, lambda: numbers)


class Downloads:
    """Brings blocks of numbers to the host, one after another.

    Args:
        stream: what copies.

    Attributes:
        at_once: blocks are there when they are begun.
    """

    def __init__(self, stream: CopyStream) -> None:
        self._stream = stream
        self._buffers = [_Buffer(stream) for _ in range(BUFFERS)]
        self._begun = 0
        self.at_once = isinstance(stream, PlainCopies)

    def begin(self, numbers: wp.array) -> Download:
        """Begin to copy (n,) float32 of the device, as the work that was begun before leaves them.

        The result of a block is to be taken before the third one after it is begun.
        """
        if self.at_once:
            return Download.of(numbers.numpy())
        size = len(numbers)
        room = self._buffers[self._begun % BUFFERS].room(size)
        self._begun += 1
        copied = self._stream.copy(room.array[:size], numbers, self._stream.mark())
        held = [numbers]

        def wait() -> None:
            self._stream.wait(copied)
            # Until now it was needed there.
            held.clear()

        return Download(wait, lambda: room.numbers[:size].copy())
