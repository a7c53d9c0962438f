"""Loops of recorded operations that a CPU runs by itself: the host makes one call in place of one for each of them.

A recorded launch takes the interpreter a microsecond or two, as long as the kernel itself takes on a mesh of some
hundred faces, and what it decides between launches takes more.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import warp as wp

from warpqem.kernels import native_program as kernels
from warpqem.runtime import new_arrays
from warpqem.runtime.cpu_calls import PackedCall
from warpqem.runtime.launches import Recorder, packed_launch

__all__ = ["NativeRecorder"]


class NativeRecorder(Recorder):
    """Operations on a CPU for one loop without the host.

    They may be branches, and launches, copies and scans of as many items as a number (1,) int32 says when they run.
    Arrays are contiguous.
    """

    def __init__(self) -> None:
        super().__init__("cpu")
        self._rows: list[tuple[int, ...]] = []

    def launch(
        self,
        kernel: wp.Kernel,
        dim: int,
        inputs: Sequence[Any],
        outputs: Sequence[Any] = (),
        *,
        counted: wp.array | None = None,
    ) -> None:
        """Launch a kernel of one axis, with ``dim`` threads or as many as are ``counted``."""
        arguments = [*inputs, *outputs]
        call = packed_launch(kernel, dim, arguments)
        addresses = call.address, ctypes.addressof(call.bounds), ctypes.addressof(call.arguments)
        self._note((kernels.LAUNCH, *addresses, _address(counted), 0), call, counted, *arguments)

    def copy(
        self,
        target: wp.array,
        source: wp.array,
        *,
        source_offset: int = 0,
        count: int | None = None,
        counted: wp.array | None = None,
    ) -> None:
        """Copy ``count`` items, or all; or ``count`` for each one that is ``counted``."""
        item = source.strides[-1]
        count = len(source) if count is None else count
        row = (kernels.COPY, target.ptr, source.ptr + item * source_offset, item, count, _address(counted))
        self._note(row, target, source, counted)

    def zero(self, array: wp.array) -> None:
        """Fill with zeros."""
        self._note((kernels.ZERO, array.ptr, array.strides[-1] * array.size, 0, 0, 0), array)

    def scan(
        self, target: wp.array, source: wp.array, *, counted: wp.array | None = None, inclusive: bool = False
    ) -> None:
        """Sums of the items before each one, int32, and of itself where they are ``inclusive``."""
        row = (kernels.SCAN, target.ptr, source.ptr, len(source), _address(counted), int(inclusive))
        self._note(row, target, source, counted)

    def branch(self, condition: wp.array, taken: Recorder) -> None:
        """Run what another one has recorded where ``condition`` (1,) int32 is not zero at that time."""
        assert isinstance(taken, NativeRecorder)
        self._note((kernels.SKIP, condition.ptr, len(taken._rows), 0, 0, 0), condition)
        self.append(taken)

    def append(self, others: NativeRecorder) -> None:
        """Run what another one has recorded."""
        self._rows += others._rows
        self._held += others._held

    def finish_loop(self, running: wp.array) -> Callable[[], None]:
        """What runs the operations again and again as long as ``running`` (1,) int32 is not zero."""
        table = np.array(self._rows, dtype=np.int64)
        operations = new_arrays.uploaded(table, dtype=wp.int64, device="cpu", copy=False)
        call = packed_launch(kernels.repeat_operations, 1, [operations, running])
        return partial(_run_loop, call, [operations, running, *self._held])

    def _note(self, row: tuple[int, ...], *held: Any) -> None:
        self._rows.append(row)
        self._held += held

    def _add(self, operation: Callable[[], object], *arguments: Any) -> None:
        raise TypeError("a loop without the host knows launches, copies, scans and branches only")


def _run_loop(call: PackedCall, held: list[Any]) -> None:
    """Run a loop; ``held`` is what its table points to, as long as it can be run."""
    call.run()


def _address(counted: wp.array | None) -> int:
    """Where a number (1,) int32 is; 0 for none."""
    if counted is None:
        return 0
    assert counted.dtype is wp.int32
    return int(counted.ptr)
