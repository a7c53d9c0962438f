"""``headline``: a shipped scene through warpqem and through what a studio would take instead, for anybody to repeat."""

from __future__ import annotations

from pathlib import Path

from benchmarks.contenders import BASE, CONTENDERS, FAST
from benchmarks.duel import add_duel
from benchmarks.machine import describe_machine
from benchmarks.report import Report
from benchmarks.settings import Settings
from benchmarks.work import usd_work

__all__ = ["SCENE", "run"]

SCENE = Path(__file__).resolve().parent.parent / "scenes" / "quadruped_gallop.usdc"
# One topology for all frames, as a game or a film needs it: the first frame decides, or the motion as attributes.
OTHERS = ("meshoptimizer, attributes", "meshoptimizer, carried", "fast-simplification, carried")
QUICK_FRAMES = 4


def run(settings: Settings) -> Report:
    """Both qualities of warpqem and its peers on the galloping quadruped."""
    names = [BASE, FAST, *OTHERS]
    report = Report("headline", "The shipped gallop", describe_machine(CONTENDERS[name].package for name in names))
    add_duel(
        report, usd_work(SCENE, settings.ratio, frame_count=QUICK_FRAMES if settings.quick else None), names, settings
    )
    report.notes += [
        "times in turn, medians of whole calls from array to array; one topology for all frames",
        "peers that are not installed fail: pip install '.[bench]' brings them",
    ]
    return report
