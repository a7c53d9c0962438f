"""Runs the parts one after the other, each within its time, and puts the report together."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from benchmarks.device import data
from benchmarks.device.findings import FAILED, read_findings
from benchmarks.device.parts import NO_GPU, PARTS, Part
from benchmarks.machine import ROOT, describe_host
from benchmarks.report import Column, Report, Row, Table
from benchmarks.settings import Settings

__all__ = ["run", "run_part"]

# Seconds that a process which has been killed may take to be gone: one that waits for a GPU may never be.
GONE_SECONDS = 5.0
# Seconds between two looks at whether a part is done.
LOOK_SECONDS = 0.02
# Times as long that a part may take where the question is whether it works, not how fast: CPUs are slow and loaded.
QUICK_PATIENCE = 5.0

CHECKS = (
    Column("part", "part"),
    Column("check", "check"),
    Column("measured", "measured"),
    Column("expected", "expected"),
    Column("verdict", "verdict"),
)


def run(settings: Settings) -> Report:
    """Verify and measure the device; or put together what a machine needs for it that has no USD."""
    if settings.pack is not None:
        return data.pack(settings)
    report = Report("device", "", describe_host([]), level=2)
    parts = [part for part in PARTS if not settings.parts or part.name in settings.parts]
    seconds = {part: part.seconds * (QUICK_PATIENCE if settings.quick else 1.0) for part in parts}
    print(f"{len(parts)} parts, {sum(seconds.values()):.0f} s at most", flush=True)
    rows: list[Row] = []
    start = time.monotonic()
    with _noted_signals() as signals, tempfile.TemporaryDirectory() as folder:
        deadline = start
        for part in parts:
            deadline += seconds[part]
            limit = deadline - time.monotonic()
            print(
                f"{part.name} (from {time.monotonic() - start:.0f} s, {limit:.0f} s at most): {part.what}", flush=True
            )
            file = Path(folder) / f"{part.name}.jsonl"
            began = time.monotonic()
            failure = run_part(part, settings, file, limit, signals)
            if signals:
                sys.exit(128 + signals[0])
            _take(report, rows, read_findings(file))
            row = {"part": part.name, "check": "time", "measured": f"{time.monotonic() - began:.1f} s"}
            if failure is not None:
                print(f"  {part.name} {failure}", flush=True)
                row |= {"measured": failure, "expected": f"done in {limit:.0f} s", "verdict": FAILED}
            rows.append(row)
    report.title = f"GPU: {', '.join(report.machine['gpus']) or 'none, run on a CPU'}"
    report.tables.insert(0, Table("Checks", CHECKS, rows))
    report.failed = [f"{row['part']}: {row['check']}" for row in rows if row.get("verdict") == FAILED]
    failed = f"{len(report.failed)} do not hold: {'; '.join(report.failed)}" if report.failed else "all hold"
    report.notes.append(f"{len(rows)} lines in {time.monotonic() - start:.0f} s, {failed}")
    return report


@contextmanager
def _noted_signals() -> Iterator[list[int]]:
    """Note SIGTERM and SIGINT instead of ending at once: a part that is left behind would keep the GPU busy."""
    noted: list[int] = []
    before = {number: signal.signal(number, lambda n, _: noted.append(n)) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield noted
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def run_part(part: Part, settings: Settings, file: Path, seconds: float, signals: Sequence[int] = ()) -> str | None:
    """Run one part; what went wrong, None if nothing did. It is ended when ``signals`` has an entry."""
    paths = [str(ROOT), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}
    end = time.monotonic() + seconds
    # A session of its own: what the part has started is ended with it.
    process = subprocess.Popen(_command(part, settings, file), env=environment, start_new_session=True)
    while process.poll() is None and time.monotonic() < end and not signals:
        time.sleep(LOOK_SECONDS)
    code = process.returncode
    _end(process)
    if code is None:
        return f"overran {seconds:.0f} s and was ended"
    if code == NO_GPU:
        sys.exit("Warp sees no GPU on this machine; --quick --device cpu tries the command itself")
    if code < 0:
        return f"was ended by {signal.Signals(-code).name}"
    return f"failed with exit code {code}, see the messages above" if code else None


def _command(part: Part, settings: Settings, file: Path) -> list[str]:
    return [sys.executable, "-m", "benchmarks.device.child", part.name, settings.to_json(), str(file)]


def _end(process: subprocess.Popen) -> None:
    """End a process and all that it has started."""
    with suppress(OSError):
        os.killpg(process.pid, signal.SIGKILL)
    with suppress(subprocess.TimeoutExpired):
        process.wait(timeout=GONE_SECONDS)


def _take(report: Report, rows: list[Row], entries: Sequence[dict[str, Any]]) -> None:
    """Add what a part has found."""
    from benchmarks.kernels import COLUMNS

    for entry in entries:
        if "row" in entry:
            rows.append(entry["row"])
        elif "machine" in entry:
            report.machine = entry["machine"]
        else:
            report.tables.append(Table(entry["title"], COLUMNS, entry["rows"]))
            note = f"floors of {entry['limits']}"
            report.notes += [] if note in report.notes else [note]
