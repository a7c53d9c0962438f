"""Levels of detail written by the command line."""

from __future__ import annotations

from pathlib import Path

from pxr import Usd
from typer.testing import CliRunner, Result

from tests.support.usd_stages import FRAMES
from warpqem.cli.main import app
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.write.stage_report import StageReport

RATIOS = (0.5, 0.2)


LEVELS = tuple(enumerate(RATIOS, 1))


GALLOP = Path(__file__).parents[2] / "scenes" / "quadruped_gallop.usdc"


# The default time, samples, times between and beyond them.
TIMES = (Usd.TimeCode.Default(), 0.0, *FRAMES, 1.5, 9.0)


def build_levels(source: Path, output: Path, **options: object) -> StageReport:
    return simplify_stage(source, output, SimplifyOptions(**{"lods": RATIOS, "device": "cpu", **options}))


def properties(stage: Usd.Stage) -> dict[str, list[object]]:
    """Everything that a stage composes to: types, applied schemas, targets, connections, and values over time."""
    found: dict[str, list[object]] = {}
    for prim in stage.TraverseAll():
        found[str(prim.GetPath())] = [prim.GetTypeName(), prim.GetAppliedSchemas(), prim.IsActive()]
        for item in prim.GetAuthoredProperties():
            if isinstance(item, Usd.Relationship):
                found[str(item.GetPath())] = [item.GetTargets()]
            else:
                found[str(item.GetPath())] = [
                    item.GetConnections(), item.GetTimeSamples(), *(item.Get(time) for time in TIMES)
                ]  # fmt: skip
    return found


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])
