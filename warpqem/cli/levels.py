"""`warpqem levels`."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from warpqem.cli.option_parameters import takes_options
from warpqem.cli.parameters import Input, JsonReport, ReportPage, StageOutput
from warpqem.cli.simplify import run_simplify
from warpqem.usd.commands.simplify_options import SimplifyOptions

__all__ = ["levels"]

# What --ratios takes the place of, and what does not go with levels.
OTHER_GOALS = (
    "ratio", "faces", "max_error", "max_distance", "screen_error", "distance", "fov", "image_height", "lods"
)  # fmt: skip


@takes_options(SimplifyOptions, without=OTHER_GOALS)
def levels(
    input_file: Input,
    output: StageOutput,
    ratios: Annotated[
        str, typer.Option(metavar="RATIOS", help="Share of the triangles that each level keeps, such as 0.5,0.25,0.1.")
    ],
    options: dict[str, Any],
    report: ReportPage = None,
    json: JsonReport = None,
) -> None:
    """Write levels of detail that nest, from one run, each with its error: what simplify does with --lods.

    OUT offers IN as LOD0 and the levels as LOD1, LOD2, ... in the variant set LOD of its default prim.

    Exit codes: 0 all done; 1 an error, or some mesh failed; 2 wrong usage; 130 interrupted.
    """
    run_simplify(input_file, output, {**options, "lods": ratios}, report, json)
