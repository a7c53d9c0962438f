"""The `warpqem` command line: one file for each command, Warp and USD loaded only when a command runs."""

from __future__ import annotations

import sys
from typing import Annotated, Any

import typer

import warpqem
from warpqem.cli.batch import batch
from warpqem.cli.compare import compare
from warpqem.cli.console import OneLineErrors
from warpqem.cli.examples import epilog
from warpqem.cli.face import face
from warpqem.cli.features import features
from warpqem.cli.help_option import HELP_NAMES, Command, Group
from warpqem.cli.info import info
from warpqem.cli.progressive import progressive
from warpqem.cli.render import render
from warpqem.cli.simplify import simplify
from warpqem.cli.view import view
from warpqem.errors import OptionError

__all__ = ["app"]

# Commands of an earlier version, and what does the same.
REMOVED = {"levels": "warpqem simplify IN -o OUT --lods RATIOS"}


class Commands(OneLineErrors, Group):
    """All commands; those that were removed are errors that name what does the same."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command that the arguments name."""
        if args[0] in REMOVED and not ctx.resilient_parsing:
            raise OptionError(f"warpqem {args[0]} was removed: use {REMOVED[args[0]]}")
        return super().resolve_command(ctx, args)


app = typer.Typer(
    name="warpqem",
    cls=Commands,
    pretty_exceptions_enable=False,
    context_settings=HELP_NAMES,
    help="Simplify animated meshes in USD files: one topology for all frames, least error over all frames.",
    epilog="Exit codes: 0 all done; 1 an error, or some mesh failed; 2 wrong usage; 130 interrupted (Ctrl-C); "
    "128 + N ended by another signal N.",
)

for command in (simplify, batch, info, compare, features, render, view):
    app.command(cls=Command, epilog=epilog(*sys.modules[command.__module__].EXAMPLES))(command)
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
