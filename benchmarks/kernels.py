"""``kernels``: time and launches of each kernel beside the least that its work can take."""

from __future__ import annotations

import time

import warp as wp

import warpqem
from benchmarks.cards import H200, LAUNCH_SECONDS, Card, card_of
from benchmarks.floor import Demand, floor_seconds
from benchmarks.launches import LaunchProfile, profile_launches
from benchmarks.machine import describe_machine
from benchmarks.report import Column, Report, Row, Table
from benchmarks.settings import Settings
from benchmarks.work import Work, torus_work
from warpqem.runtime.device import resolve_device

__all__ = ["COLUMNS", "kernel_rows", "run"]

FACES, FRAMES = 1_000_000, 16
QUICK_FACES = 10_000

COLUMNS = (
    Column("kernel", "kernel"),
    Column("launches", "launches", "d"),
    Column("milliseconds", "ms", ".2f"),
    Column("share", "share %", ".1f"),
    Column("megabytes", "MB", ".1f"),
    Column("megaflops", "Mflop", ".1f"),
    Column("floor_ms", "floor ms", ".3f"),
    Column("launch_floor_ms", "and launches ms", ".3f"),
    Column("over_floor", "time / that", ".1f"),
    Column("effective_gbs", "GB/s", ".0f"),
)


def kernel_rows(profile: LaunchProfile, card: Card = H200) -> list[Row]:
    """A row for each kernel, the longest first, and one for their sum; floors are those of a card."""
    on_gpu = any(entry.events is not None for entry in profile.entries)
    rows = [_row(kernel, launches, on_gpu, card) for kernel, launches in profile.by_kernel().items()]
    rows.sort(key=lambda row: -row["milliseconds"])
    total = sum(row["milliseconds"] for row in rows)
    for row in rows:
        row["share"] = 100 * row["milliseconds"] / total if total else 0.0
    counted = [row for row in rows if row["floor_ms"] is not None]
    sums = {key: sum(row[key] for row in counted) for key in ("megabytes", "megaflops", "floor_ms", "launch_floor_ms")}
    return [
        *rows,
        {"kernel": "all", "launches": sum(row["launches"] for row in rows), "milliseconds": total, "share": 100.0}
        | sums,
    ]


def _row(kernel: str, launches: list[tuple[float, Demand | None]], on_gpu: bool, card: Card) -> dict:
    milliseconds = 1e3 * sum(seconds for seconds, _ in launches)
    row = {"kernel": kernel, "launches": len(launches), "milliseconds": milliseconds, "floor_ms": None}
    demands = [demand for _, demand in launches if demand is not None]
    if len(demands) < len(launches):
        return row
    demand = sum(demands, start=Demand(0.0))
    # Each launch has its own floor: one may wait for memory, another for arithmetic.
    floor_ms = 1e3 * sum(floor_seconds(d, card) for d in demands)
    launch_floor_ms = 1e3 * sum(max(floor_seconds(d, card), LAUNCH_SECONDS) for d in demands)
    row |= {"megabytes": demand.bytes / 1e6, "megaflops": demand.flops / 1e6, "floor_ms": floor_ms}
    row["launch_floor_ms"] = launch_floor_ms
    if milliseconds > 0:
        row["effective_gbs"] = demand.bytes / milliseconds / 1e6
    # The floor is that of a GPU: another device's time has nothing to do with it.
    if on_gpu:
        row["over_floor"] = milliseconds / launch_floor_ms
    return row


def _simplify(work: Work, device: str) -> float:
    wp.synchronize_device(device)
    start = time.perf_counter()
    warpqem.simplify(work.points, work.faces, target_faces=work.target_faces, quality="fast", device=device)
    wp.synchronize_device(device)
    return time.perf_counter() - start


def run(settings: Settings) -> Report:
    """Profile one simplification of a generated mesh, compiled and warmed by one before it."""
    device = resolve_device(settings.device)
    report = Report("kernels", "Kernels", describe_machine(["warpqem"]))
    work = torus_work(QUICK_FACES if settings.quick else FACES, FRAMES, settings.ratio)
    _simplify(torus_work(QUICK_FACES, FRAMES, settings.ratio), device)
    plain = _simplify(work, device)
    with profile_launches() as profile:
        profiled = _simplify(work, device)
    card = card_of(wp.get_device(device).name) or H200
    rows = kernel_rows(profile, card)
    report.tables.append(Table(f"{work.name}: {work.size}, on {device}", COLUMNS, rows))
    report.notes += [
        f"the whole call took {plain:.3f} s without the profile, {profiled:.3f} s with it: launches are made one by "
        "one and not replayed as graphs, lists are read back before them, CPU threads take no turns",
        "ms: between two events on a GPU; CPU time of the one thread on a CPU",
        "floor: bytes or operations, whichever takes longer, each needed element once; and launches: no launch takes "
        f"less than one does; {card.limits}",
    ]
    uncounted = [row["kernel"] for row in rows if row["floor_ms"] is None]
    if uncounted:
        report.notes.append(f"without a floor: {', '.join(uncounted)}")
    return report
