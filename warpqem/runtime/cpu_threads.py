"""CPU threads: Warp's CPU backend runs a launch on one thread and releases the interpreter's lock meanwhile.

So a long launch is split into as many as there are cores, each over its own part of the work. A GPU needs none of this.
"""

from __future__ import annotations

import functools
import itertools
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial

from warpqem.errors import OptionError
from warpqem.runtime.device import device_traits
from warpqem.runtime.thread_limit import thread_limit

__all__ = ["launch_parts", "part_count", "run_parts", "split_range", "thread_count"]


@functools.cache
def _core_count() -> int:
    """Cores this process may use, or WARPQEM_THREADS where that is set (for batches with a process per core)."""
    asked = os.environ.get("WARPQEM_THREADS")
    if asked is not None:
        if not (asked.isascii() and asked.isdecimal()) or int(asked) < 1:
            raise OptionError(f"WARPQEM_THREADS must be a whole number of at least 1, got {asked!r}")
        return int(asked)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


# Shared by all callers. Parts never wait for other parts, so they cannot wait for each other.
@functools.cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(_core_count(), thread_name_prefix="warpqem")


# A forked process has none of the pool's threads.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)


def thread_count(device: str) -> int:
    """Threads that long launches on the device are split over: 1 on a GPU, no more than the call at work is worth."""
    if not device_traits(device).splits_launches:
        return 1
    limit = thread_limit()
    return _core_count() if limit is None else min(_core_count(), limit)


def split_range(count: int, parts: int) -> list[slice]:
    """``count`` items in at most ``parts`` consecutive slices of nearly equal length, none empty."""
    parts = max(1, min(parts, count))
    ends = [count * k // parts for k in range(parts + 1)]
    return [slice(a, b) for a, b in itertools.pairwise(ends)]


def run_parts(parts: Sequence[Callable[[], object]]) -> None:
    """Run all parts, at once where there are several; the first error is raised when all have ended."""
    if len(parts) == 1:
        parts[0]()
        return
    futures = [_pool().submit(part) for part in parts[1:]]
    try:
        parts[0]()
    finally:
        errors = [future.exception() for future in futures]
    for error in errors:
        if error is not None:
            raise error


def part_count(count: int, device: str, least: int = 1) -> int:
    """Parts that ``count`` items are worked on in: one for each thread of the device, of ``least`` items or more."""
    most = count // least
    return 1 if most <= 1 else min(thread_count(device), most)


def launch_parts(launch: Callable[[slice], object], count: int, device: str, least: int = 1) -> None:
    """Call ``launch`` for slices of ``count`` items, one for each thread of the device, of ``least`` items or more."""
    run_parts([partial(launch, part) for part in split_range(count, part_count(count, device, least))])
