"""Launches of a pass: operations recorded once, and run in every pass with next to no work on the host."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import warp as wp

from warpqem.kernels.work import EdgeList, Work
from warpqem.runtime import new_arrays
from warpqem.runtime.cpu_threads import run_parts
from warpqem.runtime.device import device_traits
from warpqem.runtime.launches import DirectRecorder, Recorder

__all__ = ["LaunchGroup", "RecordedLaunches", "new_edge_list", "part_work", "record_shared", "run_once"]


@dataclass(frozen=True)
class LaunchGroup:
    """Operations that may run at once, one group for each part of the work.

    Attributes:
        record: records the operations of one part.
        part_count: parts, each on its own thread; 1 for what one thread does alone.
    """

    record: Callable[[Recorder, int], None]
    part_count: int = 1


class RecordedLaunches:
    """Groups of launches one after another, recorded when this is made, run as often as asked."""

    def __init__(self, groups: Sequence[LaunchGroup], device: str) -> None:
        self._device = device
        self._runs: list[list[Callable[[], None]]] = []
        for part_count, run in itertools.groupby(groups, key=lambda group: group.part_count):
            alike = list(run)
            if part_count == 1:
                self._runs.append([self._recorded(alike, 0)])
                continue
            for group in alike:
                self._runs.append([self._recorded([group], part) for part in range(part_count)])

    def _recorded(self, groups: Sequence[LaunchGroup], part: int) -> Callable[[], None]:
        recorder = Recorder(self._device)
        for group in groups:
            group.record(recorder, part)
        return recorder.finish()

    def run(self) -> None:
        """Run all; on a CPU, done when this returns."""
        for parts in self._runs:
            run_parts(parts)


def run_once(groups: Sequence[LaunchGroup], device: str) -> None:
    """Run groups of launches one after another, of which nothing is recorded but what threads share."""
    if not device_traits(device).captures and any(group.part_count > 1 for group in groups):
        RecordedLaunches(groups, device).run()
        return
    recorder = DirectRecorder(device)
    for group in groups:
        for part in range(group.part_count):
            group.record(recorder, part)


class _SharedWork(type(Work())):  # type: ignore[misc]  # made by Warp
    """A share of work that many launches have in common: whoever changed it would change what all of them do."""

    def __init__(self, **values: int) -> None:
        super().__init__()
        for name, value in values.items():
            super().__setattr__(name, value)

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"{name} of a share that other launches have too cannot be changed")


def part_work(part: int, part_count: int, device: str) -> Work:
    """The share of one part."""
    return _work(part, part_count, device_traits(device).launch_threads)


@functools.cache
def _work(part: int, part_count: int, thread_count: int) -> Work:
    """Kept, as every launch of a pass has one, and making one takes longer than the launch."""
    return _SharedWork(part=part, part_count=part_count, thread_count=thread_count)


def record_shared(
    recorder: Recorder, kernel: wp.Kernel, inputs: Sequence[Any], work: Work, outputs: Sequence[Any] = ()
) -> None:
    """Record a kernel that deals out its items by ``work``, its last input."""
    recorder.launch(kernel, work.thread_count, [*inputs, work], outputs)


def new_edge_list(storage: wp.array, part_count: int) -> EdgeList:
    """An empty list in ``part_count`` segments of ``storage`` (3N,) int32."""
    edges = EdgeList()
    edges.half_edge = storage
    edges.count = new_arrays.zeros(part_count, dtype=wp.int32, device=storage.device)
    edges.capacity = len(storage) // part_count
    return edges
