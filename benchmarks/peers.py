"""``peers``: an animation through warpqem and its peers."""

from __future__ import annotations

from benchmarks.contenders import CONTENDERS
from benchmarks.duel import add_duel
from benchmarks.machine import describe_machine
from benchmarks.report import Report
from benchmarks.settings import Settings
from benchmarks.work import Work, quadruped_work, torus_work, usd_work

__all__ = ["run"]

FACES, FRAMES = 40000, 48
QUICK_FACES, QUICK_FRAMES = 4000, 12


def _work(settings: Settings) -> Work:
    if settings.usd is not None:
        return usd_work(settings.usd, settings.ratio, settings.prim, QUICK_FRAMES if settings.quick else None)
    if settings.quick:
        return torus_work(QUICK_FACES, QUICK_FRAMES, settings.ratio)
    print("building the quadruped")
    return quadruped_work(FACES, FRAMES, settings.ratio)


def run(settings: Settings) -> Report:
    """All contenders on one animation."""
    report = Report("peers", "warpqem and its peers", describe_machine(c.package for c in CONTENDERS.values()))
    add_duel(report, _work(settings), list(CONTENDERS), settings)
    report.notes += [
        "times of the contenders in turn, medians; time / warpqem's is the median of the ratios within each turn",
        "per frame: every frame has its own topology, so there is no slide and no edge to follow",
        "carried: the first frame decides, the other frames follow its vertices (pyfqmr does not say which those are)",
    ]
    return report
