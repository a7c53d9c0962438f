"""Arguments and options that several commands have."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from warpqem.cli.option_parameters import parameter_of
from warpqem.option_fields import named_options
from warpqem.usd.simplify_options import SimplifyOptions

__all__ = ["Device", "Frames", "Input", "JsonReport", "MeshMemory", "Output", "Prims", "ReportPage"]


def _as_of_simplify(name: str) -> Any:
    return parameter_of(named_options(SimplifyOptions)[name], basic=True).annotation.__metadata__[0]


Input = Annotated[str, typer.Argument(metavar="IN", help="USD file to read (.usd, .usda, .usdc, .usdz).")]

Output = Annotated[
    str,
    typer.Option(
        "--output", "-o", metavar="OUT", help="USD file to write (.usd, .usda, .usdc); replaced if it exists, never IN."
    ),
]

Prims = Annotated[list[str] | None, _as_of_simplify("prim")]

Frames = Annotated[str | None, _as_of_simplify("frames")]

Device = Annotated[str | None, _as_of_simplify("device")]

JsonReport = Annotated[
    str | None,
    typer.Option("--json", metavar="FILE", help="Write the report as JSON to FILE, or to stdout for -."),
]

ReportPage = Annotated[
    str | None,
    typer.Option(
        "--report",
        metavar="FILE",
        help="Write a page (.html) that shows both in motion, their distance and all figures; it opens offline.",
    ),
]

MeshMemory = Annotated[
    str | None,
    typer.Option(
        "--memory",
        metavar="BYTES",
        help="Memory that a progressive mesh may take, such as 8G or 500M, where the file is trusted; by default 64M, "
        "or 256 times the size of the file where that is more. Files of this version of warpqem need no more.",
    ),
]
