"""Arguments and options that several commands have."""

from __future__ import annotations

from typing import Annotated

import typer

__all__ = ["Device", "Frames", "Input", "JsonReport", "Output", "Prims"]

Input = Annotated[str, typer.Argument(metavar="IN", help="USD file to read (.usd, .usda, .usdc, .usdz).")]

Output = Annotated[
    str,
    typer.Option(
        "--output", "-o", metavar="OUT", help="USD file to write (.usd, .usda, .usdc); replaced if it exists, never IN."
    ),
]

Prims = Annotated[
    list[str] | None,
    typer.Option(
        "--prim",
        metavar="PATH",
        help="Only the meshes at and below this prim path, such as /Root/Body; may be given several times.",
    ),
]

Frames = Annotated[
    str | None,
    typer.Option(
        "--frames",
        metavar="START:END[:STEP]",
        help="Only the samples from START to END, in time codes; with STEP, poses interpolated every STEP time codes.",
    ),
]

Device = Annotated[
    str | None,
    typer.Option(
        "--device", metavar="NAME", help="Warp device, such as cpu or cuda:0; by default the GPU if there is one."
    ),
]

JsonReport = Annotated[
    str | None,
    typer.Option("--json", metavar="FILE", help="Write the report as JSON to FILE, or to stdout for -."),
]
