"""``static``: one frame of a large mesh, the work the peers were made for."""

from __future__ import annotations

from benchmarks.contenders import CONTENDERS, STATIC
from benchmarks.duel import add_duel
from benchmarks.machine import describe_machine
from benchmarks.report import Report
from benchmarks.settings import Settings
from benchmarks.work import torus_work

__all__ = ["run"]

FACES = 1_000_000
QUICK_FACES = 20_000


def run(settings: Settings) -> Report:
    """All contenders that simplify a single frame, on one frame."""
    packages = [CONTENDERS[name].package for name in STATIC]
    report = Report("static", "One frame", describe_machine(packages))
    faces = QUICK_FACES if settings.quick else FACES
    add_duel(report, torus_work(faces, 1, settings.ratio), STATIC, settings)
    return report
