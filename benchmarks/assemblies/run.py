"""The command: each assembly through the contenders that keep one topology."""

from __future__ import annotations

from benchmarks.assemblies.kinds import ASSEMBLIES, FRAMES, assembly
from benchmarks.contenders import BASE, CONTENDERS, FAST
from benchmarks.duel import add_duel
from benchmarks.machine import describe_machine
from benchmarks.report import Report
from benchmarks.settings import Settings
from benchmarks.work import Work

__all__ = ["run"]

# Peers that move one topology through all frames.
NAMES = (BASE, FAST, "meshoptimizer, carried", "meshoptimizer, attributes", "fast-simplification, carried")
QUICK_FRAMES, QUICK_KINDS = 4, ("bolted_plate",)


def run(settings: Settings) -> Report:
    """A table for each assembly."""
    report = Report("assemblies", "Meshes of many parts", describe_machine(CONTENDERS[n].package for n in NAMES))
    for name in QUICK_KINDS if settings.quick else ASSEMBLIES:
        made = assembly(name, QUICK_FRAMES if settings.quick else FRAMES)
        work = Work(
            f"{name}, {made.part_count} parts", made.points, made.faces, round(settings.ratio * len(made.faces))
        )
        add_duel(report, work, NAMES, settings)
    return report
