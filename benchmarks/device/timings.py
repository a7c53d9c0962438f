"""How fast it is."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import warp as wp

import warpqem
from benchmarks.device.checks import fingerprint
from benchmarks.device.data import main_work, works
from benchmarks.device.findings import Findings
from benchmarks.figures import median
from benchmarks.work import Work, torus_work

__all__ = ["million", "refit", "scenes", "static"]

MILLION, STATIC = (1_000_000, 48), (1_300_000, 1)
QUICK_MILLION, QUICK_STATIC = (2_000, 4), (2_000, 1)
# Runs that count: a small mesh varies by more than it takes.
TURNS, SMALL_TURNS = 5, 20


def scenes(found: Findings) -> None:
    """The meshes of the data, one after the other."""
    for work in works(found.settings):
        _time(found, work, SMALL_TURNS, quality="fast")


def million(found: Findings) -> None:
    """A large animation."""
    _time(
        found,
        torus_work(*(QUICK_MILLION if found.settings.quick else MILLION), found.settings.ratio),
        TURNS,
        quality="fast",
    )


def static(found: Findings) -> None:
    """A large single frame."""
    _time(
        found,
        torus_work(*(QUICK_STATIC if found.settings.quick else STATIC), found.settings.ratio),
        TURNS,
        quality="fast",
    )


def refit(found: Findings) -> None:
    """With the refit: its time, and its bits twice."""
    work = main_work(found.settings)
    _time(found, work, TURNS, quality="best")
    first, second = (fingerprint(work, found.device, quality="best") for _ in range(2))
    found.expect(f"{work.name}, best, bits", f"{first}, {second}", "the same twice", first == second)


def _time(found: Findings, work: Work, turns: int, **options: Any) -> None:
    """The first run, then the median of the others; each from arrays on the host to arrays on the host."""
    turns = min(turns, found.settings.turns) if found.settings.quick else turns
    name = ", ".join([work.name, *map(str, options.values())])
    first = _seconds(work, found.device, options)
    found.measured(f"{name}, first run", f"{1e3 * first:.1f} ms", first)
    times = [_seconds(work, found.device, options) for _ in range(turns)]
    middle = median(times)
    each = 1e9 * middle / (len(work.faces) * len(work.points))
    text = f"{1e3 * middle:.1f} ms ({1e3 * min(times):.1f} to {1e3 * max(times):.1f}), {each:.1f} ns per face and frame"
    found.measured(f"{name}, {turns} runs", text, middle)
    if wp.get_device(found.device).is_cuda and wp.is_mempool_enabled(found.device):
        high = wp.get_mempool_used_mem_high(found.device)
        found.measured(f"{name}, memory", f"{high / 1e6:.0f} MB at most in the pool", high)


def _seconds(work: Work, device: str, options: dict[str, Any]) -> float:
    wp.synchronize_device(device)
    start = time.perf_counter()
    result = warpqem.simplify(work.points, work.faces, target_faces=work.target_faces, device=device, **options)
    assert np.isfinite(result.points[0]).all()
    return time.perf_counter() - start
