"""The table of a duel: one piece of work, all contenders in turn, time beside quality."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from benchmarks.contenders import BASE, CONTENDERS
from benchmarks.figures import median, ratio_in_turn
from benchmarks.quality import measure_quality
from benchmarks.report import Column, Report, Row, Table
from benchmarks.settings import Settings
from benchmarks.turns import Outcome, run_in_turn
from benchmarks.work import Work

__all__ = ["add_duel", "outcome_row"]

COLUMNS = (
    Column("contender", "contender"),
    Column("ratio", "time / warpqem's", ".2f"),
    Column("cpu_ratio", "CPU time / warpqem's", ".2f"),
    Column("seconds", "s", ".3f"),
    Column("cpu_seconds", "CPU s", ".3f"),
    Column("ns", "ns / face / frame", ".0f"),
    Column("peak_mb", "host MB", ".0f"),
    Column("faces", "faces", "d"),
    Column("rms", "RMS %", ".4f"),
    Column("hausdorff", "Hausdorff %", ".3f"),
    Column("edge_length_error", "edges %", ".2f"),
    Column("slide", "slide %", ".3f"),
    Column("jitter", "jitter %", ".3f"),
)


def outcome_row(name: str, work: Work, outcome: Outcome, base: Outcome | None, device: str | None) -> Row:
    """One contender's figures; its quality only where there is a result, its ratio where both ran every turn."""
    row: dict[str, Any] = {"contender": name, "way": CONTENDERS[name].way, "failure": outcome.failure}
    if outcome.seconds:
        seconds = median(outcome.seconds)
        row |= {
            "seconds": seconds,
            "all_seconds": outcome.seconds,
            "cpu_seconds": median(outcome.cpu_seconds),
            "ns": 1e9 * seconds / (len(work.faces) * len(work.points)),
            "peak_mb": outcome.peak_bytes / 1e6,
        }
    if base is not None and outcome.seconds and len(outcome.seconds) == len(base.seconds):
        row["ratio"] = ratio_in_turn(outcome.seconds, base.seconds)
        # On a machine that others use too, CPU time says more than the clock.
        row["cpu_ratio"] = ratio_in_turn(outcome.cpu_seconds, base.cpu_seconds)
    if outcome.result is not None:
        row |= measure_quality(work, outcome.result, device)
    return row


def add_duel(report: Report, work: Work, names: Sequence[str], settings: Settings) -> None:
    """Run the contenders in turn and add their table, and a note for each that failed."""
    outcomes = run_in_turn(work, names, settings.turns, settings.device)
    print(f"{work.name}: measuring quality")
    rows = [outcome_row(name, work, o, outcomes.get(BASE), settings.device) for name, o in outcomes.items()]
    report.tables.append(Table(f"{work.name}: {work.size}", COLUMNS, rows))
    report.notes += [f"{row['contender']} failed: {row['failure']}" for row in rows if row["failure"]]
