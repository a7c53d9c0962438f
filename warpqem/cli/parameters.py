"""Arguments and options that several commands have."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from warpqem.arguments.option_fields import named_options
from warpqem.cli.option_parameters import parameter_of
from warpqem.usd.commands.simplify_options import SimplifyOptions

__all__ = [
    "Device",
    "Frames",
    "Input",
    "JsonReport",
    "MeshInput",
    "MeshMemory",
    "MeshOutput",
    "Output",
    "Prims",
    "ReportPage",
    "Variants",
]


def _as_of_simplify(name: str) -> Any:
    return parameter_of(named_options(SimplifyOptions)[name], basic=True).annotation.__metadata__[0]


Input = Annotated[str, typer.Argument(metavar="IN", help="USD file to read (.usd, .usda, .usdc, .usdz).")]

Output = Annotated[
    str,
    typer.Option(
        "--output",
        "-o",
        metavar="OUT",
        rich_help_panel="Output",
        help="USD file to write (.usd, .usda, .usdc); replaced if it exists, never IN.",
    ),
]

Prims = Annotated[list[str] | None, _as_of_simplify("prim")]

Frames = Annotated[str | None, _as_of_simplify("frames")]
MeshInput = Annotated[
    str,
    typer.Argument(
        metavar="IN",
        help="USD file to read, an animated GLB, or mesh files, one for each frame, such as 'horse-*.ply'.",
    ),
]

MeshOutput = Annotated[
    str,
    typer.Option(
        "--output",
        "-o",
        metavar="OUT",
        rich_help_panel="Output",
        help="File to write: .usd, .usda, .usdc or .usdz, a .glb, or mesh files such as out/horse_####.ply.",
    ),
]

Variants = Annotated[
    list[str] | None,
    typer.Option(
        "--variant",
        metavar="SET=NAME",
        rich_help_panel="Input",
        help="Variant to look at instead of the one that the file selects, such as LOD=LOD1; '/Prim/Path{SET=NAME}' "
        "where several prims have the set. May be given several times, and goes for each file that has the set.",
    ),
]

Device = Annotated[str | None, _as_of_simplify("device")]

JsonReport = Annotated[
    str | None,
    typer.Option(
        "--json", metavar="FILE", rich_help_panel="Output", help="Write the report as JSON to FILE, or to stdout for -."
    ),
]

ReportPage = Annotated[
    str | None,
    typer.Option(
        "--report",
        metavar="FILE",
        rich_help_panel="Output",
        help="Write a page (.html) that shows both in motion, offline.",
    ),
]

MeshMemory = Annotated[
    str | None,
    typer.Option(
        "--memory",
        metavar="BYTES",
        rich_help_panel="Machine",
        help="Memory that a progressive mesh may take, such as 8G or 500M, where the file is trusted; by default 64M, "
        "or 256 times the size of the file where that is more. Files of this version of warpqem need no more.",
    ),
]
