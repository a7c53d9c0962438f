"""Times of kernel launches, by standing in for ``warp.launch`` and ``Launch.launch`` while a profile is taken."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import prod
from typing import Any

import warp as wp

from benchmarks.floor import Demand, count_demand

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

    def time(self, kernel: Any, arguments: Sequence[Any], lanes: int, device: wp.Device, go: Callable[[], Any]) -> Any:
        """Do a launch and note its time and demand.

        While a graph is captured nothing runs, so there is nothing to time: the launch is noted without a time.
        """
        if device.is_cuda and device.is_capturing:
            self.entries.append(_Entry(f"{kernel.key} (captured)", None))
            return go()
        names = [argument.label for argument in kernel.adj.args]
        entry = _Entry(kernel.key, count_demand(kernel.key, dict(zip(names, arguments, strict=True)), lanes))
        if device.is_cpu:
            start = time.perf_counter()
            result = go()
            entry.seconds = time.perf_counter() - start
        else:
            before = wp.Event(device, enable_timing=True)
            after = wp.Event(device, enable_timing=True)
            device.stream.record_event(before)
            result = go()
            device.stream.record_event(after)
            entry.events = (before, after)
        # Threads append each on their own; a list takes that.
        self.entries.append(entry)
        return result


def _lanes(dim: int | Sequence[int]) -> int:
    return dim if isinstance(dim, int) else prod(dim)


@contextmanager
def profile_launches() -> Iterator[LaunchProfile]:
    """Time every launch made through ``warp.launch`` or a recorded ``Launch`` until the block ends.

    Launches split over CPU threads run at once: their times are those of the threads, and add up to core time.
    """
    profile = LaunchProfile()
    plain_launch, recorded_launch = wp.launch, wp.Launch.launch

    def launch(kernel: Any, dim: Any, inputs: Sequence = (), outputs: Sequence = (), **options: Any) -> Any:
        def go() -> Any:
            return plain_launch(kernel, dim, inputs, outputs, **options)

        if options.get("record_cmd"):
            return go()
        device = wp.get_device(options.get("device"))
        return profile.time(kernel, [*inputs, *outputs], _lanes(dim), device, go)

    def launch_recorded(self: wp.Launch, stream: wp.Stream | None = None) -> None:
        size = int(self.bounds.size)
        profile.time(self.kernel, self.fwd_args or [], size, self.device, lambda: recorded_launch(self, stream))

    wp.launch, wp.Launch.launch = launch, launch_recorded
    try:
        yield profile
    finally:
        wp.launch, wp.Launch.launch = plain_launch, recorded_launch
