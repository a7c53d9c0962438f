"""Times of kernel launches, by standing in for ``warp.launch`` and prepared calls while a profile is taken.

A replayed graph does not tell its kernels apart, nor does a loop without the host, so steps and loops make their
launches one by one meanwhile, part after part on one thread.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from math import prod
from typing import Any
from unittest.mock import patch

import warp as wp

from benchmarks.floor import Demand, count_demand
from warpqem.decimation import native_loop
from warpqem.decimation.recorded_launches import LaunchGroup, RecordedLaunches
from warpqem.runtime import launches
from warpqem.runtime.launches import DirectRecorder, Recorder

__all__ = ["LaunchProfile", "profile_launches"]


@dataclass
class _Entry:
    """One launch: the time is known at once on a CPU, and from two events on a GPU."""

    kernel: str
    demand: Demand | None
    seconds: float = 0.0
    events: tuple[wp.Event, wp.Event] | None = None


@dataclass
class LaunchProfile:
    """The launches of a stretch of code, in order."""

    entries: list[_Entry] = field(default_factory=list)

    def by_kernel(self) -> dict[str, list[tuple[float, Demand | None]]]:
        """Seconds and demand of each launch by kernel; waits for the GPU."""
        table: dict[str, list[tuple[float, Demand | None]]] = {}
        for entry in self.entries:
            seconds = entry.seconds
            if entry.events is not None:
                seconds = wp.get_event_elapsed_time(*entry.events) / 1000.0
            table.setdefault(entry.kernel, []).append((seconds, entry.demand))
        return table

    def time(self, command: wp.Launch, threads: int) -> None:
        """Do a recorded launch and note its time and demand."""
        kernel, device = command.kernel, command.device
        names = [argument.label for argument in kernel.adj.args]
        arguments = dict(zip(names, command.fwd_args or [], strict=True))
        entry = _Entry(kernel.key, count_demand(kernel.key, arguments, threads))
        self.entries.append(entry)
        if device.is_cpu:
            # The kernel runs on this thread: its CPU time leaves out what else the machine does.
            start = time.thread_time()
            command.launch()
            entry.seconds = time.thread_time() - start
            return
        before, after = (wp.Event(device, enable_timing=True) for _ in range(2))
        device.stream.record_event(before)
        command.launch()
        device.stream.record_event(after)
        entry.events = (before, after)


def _thread_count(dim: int | Sequence[int]) -> int:
    return dim if isinstance(dim, int) else prod(dim)


@contextmanager
def profile_launches() -> Iterator[LaunchProfile]:
    """Time every launch until the block ends.

    On a CPU the parts of a launch that threads would share come one after another: their times add up to core time.
    """
    profile = LaunchProfile()
    plain_launch = wp.launch

    def launch(kernel: Any, dim: Any, inputs: Sequence = (), outputs: Sequence = (), **options: Any) -> None:
        # Recorded first: most of what a launch takes on the host stays out of its time.
        command = plain_launch(kernel, dim, inputs, outputs, record_cmd=True, **options)
        # A launch without threads is none.
        if command is not None:
            profile.time(command, _thread_count(dim))

    def keep_groups(self: Any, groups: Sequence[LaunchGroup], device: str) -> None:
        self.groups, self.device = list(groups), device

    def run_groups(self: Any) -> None:
        for group in self.groups:
            for part in range(group.part_count):
                group.record(DirectRecorder(self.device), part)

    def record(self: Any, kernel: wp.Kernel, dim: int, inputs: Sequence, outputs: Sequence = ()) -> None:
        self._add(partial(launch, kernel, dim, list(inputs), list(outputs), device=self._device), *inputs, *outputs)

    def prepare(kernel: wp.Kernel, dim: Any, arguments: Sequence, device: wp.DeviceLike) -> Any:
        return partial(launch, kernel, dim, arguments, device=device)

    stand_ins = (
        patch.object(wp, "launch", launch),
        patch.object(launches, "_cpu_call", prepare),
        patch.object(Recorder, "launch", record),
        patch.object(Recorder, "_finish", lambda self, run: run),
        patch.object(native_loop, "SMALL_FACES", 0),
        patch.object(RecordedLaunches, "__init__", keep_groups),
        patch.object(RecordedLaunches, "run", run_groups),
    )
    with ExitStack() as stack:
        for stand_in in stand_ins:
            stack.enter_context(stand_in)
        yield profile
