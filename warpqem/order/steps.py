"""Steps of a pass: launches recorded once as graphs, and replayed with next to no work on the host."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import warp as wp

from warpqem.kernels.work import EdgeList, Work
from warpqem.parallel import run_parts

__all__ = ["Phase", "Step", "new_edge_list", "part_work"]

# On a GPU a work list of unknown length is walked by this many lanes: enough to fill any device of today.
GPU_LANES = 65536


@dataclass(frozen=True)
class Phase:
    """Launches that may run at once, one for each part of the work.

    Attributes:
        launch: makes the launches of one part; it is called while a graph is captured.
        part_count: parts, each on its own thread; 1 for what one thread does alone.
    """

    launch: Callable[[int], object]
    part_count: int = 1


class Step:
    """Phases one after another, captured on the device when the step is made, run as often as asked."""

    def __init__(self, phases: Sequence[Phase], device: str) -> None:
        self._device = device
        self._graphs: list[list[wp.Graph]] = []
        for part_count, group in itertools.groupby(phases, key=lambda phase: phase.part_count):
            phases_alike = list(group)
            if part_count == 1:
                self._graphs.append([self._capture([partial(phase.launch, 0) for phase in phases_alike])])
                continue
            for phase in phases_alike:
                self._graphs.append([self._capture([partial(phase.launch, part)]) for part in range(part_count)])

    def _capture(self, launches: Sequence[Callable[[], object]]) -> wp.Graph:
        with wp.ScopedCapture(device=self._device) as capture:
            for launch in launches:
                launch()
        return capture.graph

    def run(self) -> None:
        """Replay the graphs; on a CPU, done when this returns."""
        for graphs in self._graphs:
            run_parts([partial(wp.capture_launch, graph) for graph in graphs])


def part_work(part: int, part_count: int, device: str) -> Work:
    """The share of one part."""
    work = Work()
    work.part, work.part_count = part, part_count
    work.lanes = 1 if wp.get_device(device).is_cpu else GPU_LANES
    return work


def new_edge_list(storage: wp.array, part_count: int) -> EdgeList:
    """An empty list in ``part_count`` segments of ``storage`` (3N,) int32."""
    edges = EdgeList()
    edges.half_edge = storage
    edges.count = wp.zeros(part_count, dtype=wp.int32, device=storage.device)
    edges.capacity = len(storage) // part_count
    return edges
