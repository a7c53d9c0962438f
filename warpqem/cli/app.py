"""The `warpqem` command line: one file for each command, Warp and USD loaded only when a command runs."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from typing import Annotated, Any

import typer

import warpqem
from warpqem.cli.console import OneLineErrors
from warpqem.cli.examples import epilog
from warpqem.cli.help_option import HELP_NAMES, Command, Group
from warpqem.errors import OptionError

__all__ = ["COMMANDS", "app"]

# Each stands in a module of its name, which is loaded when it runs. This is what the help of all says of it, the first
# paragraph of its own: it takes half of the time of `--help` to load them all.
COMMANDS = {
    "simplify": "Simplify every mesh over all its frames.",
    "batch": "Simplify many assets, each as `warpqem simplify` does; one that fails costs the others nothing.",
    "info": "Describe every mesh: frames, vertices, faces, edges, skin, blend shapes, UV sets, subsets, problems.",
    "compare": "Measure the meshes that TEST shows against those that REFERENCE shows at the same prim path, at the "
    "frames of both. What instances share is measured once.",
    "features": "Colour the motion features, the parts that bend while a mesh moves: one colour for each, grey for the "
    "rest.",
    "render": "Draw a contact sheet: the meshes of IN at several times, beside those of a reference, without a "
    "browser.",
    "view": "Look at meshes in motion in the browser, until interrupted.",
    "warmup": "Compile all kernels ahead of time, on all cores: for an image, a farm, or a first run without a wait.",
    "progressive": "Progressive meshes: every level of one animated mesh in one file, from one run.",
    "face": "Faces: named feature points, levels that keep them, expressions transferred.",
}
# Commands of an earlier version, and what does the same.
REMOVED = {"levels": "warpqem simplify IN -o OUT --lods RATIOS"}


def _load(name: str) -> Any:
    """A command, or a group of them, as click has it."""
    module = importlib.import_module(f"warpqem.cli.{name}")
    command = getattr(module, name)
    if isinstance(command, typer.Typer):
        return typer.main.get_command(command)
    alone = typer.Typer(add_completion=False)
    alone.command(name, cls=Command, epilog=epilog(*module.EXAMPLES))(command)
    return typer.main.get_command(alone)


class _LaterCommands(Mapping[str, Any]):
    """All commands by name, each loaded when it is asked for."""

    def __init__(self) -> None:
        self._loaded: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        if name not in COMMANDS:
            raise KeyError(name)
        if name not in self._loaded:
            self._loaded[name] = _load(name)
        return self._loaded[name]

    def __iter__(self) -> Iterator[str]:
        return iter(COMMANDS)

    def __len__(self) -> int:
        return len(COMMANDS)


class Commands(OneLineErrors, Group):
    """All commands; those that were removed are errors that name what does the same.

    Attributes:
        summaries: what the help says of each command.
    """

    summaries = COMMANDS

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands: Any = _LaterCommands()

    def list_commands(self, ctx: Any) -> list[str]:
        """The names."""
        return list(COMMANDS)

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
