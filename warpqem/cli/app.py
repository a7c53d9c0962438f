"""The `warpqem` command line: one file for each command, Warp and USD loaded only when a command runs."""

from __future__ import annotations

from typing import Annotated

import typer

import warpqem
from warpqem.cli.batch import batch
from warpqem.cli.compare import compare
from warpqem.cli.console import OneLineErrors
from warpqem.cli.examples import epilog
from warpqem.cli.face import face
from warpqem.cli.features import features
from warpqem.cli.info import info
from warpqem.cli.levels import levels
from warpqem.cli.progressive import progressive
from warpqem.cli.render import render
from warpqem.cli.simplify import simplify
from warpqem.cli.view import view

__all__ = ["app"]

app = typer.Typer(
    name="warpqem",
    cls=OneLineErrors,
    pretty_exceptions_enable=False,
    help="Simplify animated meshes in USD files: one topology for all frames, least error over all frames.",
    epilog="Exit codes: 0 all done; 1 an error, or some mesh failed; 2 wrong usage; 130 interrupted (Ctrl-C); "
    "128 + N ended by another signal N.",
)

for command in (simplify, batch, info, compare, features, render, view, levels):
    app.command(epilog=epilog(command.__name__))(command)
app.add_typer(progressive)
app.add_typer(face)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"warpqem {warpqem.__version__}")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    pass
