"""Loops on a device: operations repeated until the device itself says that it is done."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

import numpy as np
import warp as wp

from warpqem.runtime.device import device_traits
from warpqem.runtime.launches import Recorder

__all__ = ["DeviceLoop"]

# Turns that are queued on a device beyond the one whose report the host looks at: one keeps the device busy meanwhile,
# the second covers a host that is late.
AHEAD = 2


class DeviceLoop:
    """Operations that are repeated as long as the first number of a report is not zero.

    Where a graph may hold a loop, all turns are one launch. Elsewhere turns are queued ahead of the host, which looks
    at the reports of earlier ones, so that some run after the last: they must change nothing then.

    Args:
        body: the operations of a turn, which write the report. Nothing in it may allocate memory.
        report: (n,) int32 on the device.
        device: Warp device.
        in_turns: The host wants to see each turn; then no graph holds the loop.
    """

    def __init__(self, body: Recorder, report: wp.array, device: str, in_turns: bool = False) -> None:
        self._report, self._in_turns = report, in_turns or not device_traits(device).graph_loops
        self._run = body.finish() if self._in_turns else body.finish_loop(report[:1])
        self._readbacks: list[_Readback] = []

    def run(self) -> np.ndarray:
        """All turns; the last report (n,) int32."""
        self.complete()
        return np.array(self._report.numpy())

    def complete(self) -> None:
        """All turns, without a wait for the last one where the device itself ends them."""
        if self._in_turns:
            for _ in self.turns():
                pass
        else:
            self._run()

    def turns(self, ahead: int | None = None) -> Iterator[np.ndarray]:
        """Turn after turn, one at least, of a loop made ``in_turns``; the report (n,) int32 after each.

        Args:
            ahead: turns that may be under way beyond the one reported. With 0, the device is where the report says.
        """
        ahead = AHEAD if ahead is None else ahead
        while len(self._readbacks) <= ahead:
            self._readbacks.append(_Readback(self._report))
        queued: deque[_Readback] = deque()
        spare = deque(self._readbacks)
        while True:
            self._run()
            queued.append(spare.popleft())
            queued[-1].begin()
            if len(queued) <= ahead:
                continue
            report = queued[0].wait()
            spare.append(queued.popleft())
            yield report
            if not report[0]:
                return


class _Readback:
    """A copy of an array on the host that is made while the device works on."""

    def __init__(self, source: wp.array) -> None:
        self._source = source
        # A CPU device copies at once, and has no pinned memory where there is no GPU.
        is_cuda = source.device.is_cuda
        self._copy = wp.empty(source.shape, dtype=source.dtype, device="cpu", pinned=is_cuda)
        self._copied = wp.Event(source.device) if is_cuda else None

    def begin(self) -> None:
        """Queue the copy."""
        wp.copy(self._copy, self._source)
        if self._copied is not None:
            self._source.device.stream.record_event(self._copied)

    def wait(self) -> np.ndarray:
        """The numbers, once they are there."""
        if self._copied is not None:
            wp.synchronize_event(self._copied)
        return np.array(self._copy.numpy())
