"""The functions behind the commands of the command line."""

import importlib
from collections.abc import Callable, Iterator

import typer

from warpqem.cli.app import COMMANDS

__all__ = ["command_functions"]


def command_functions() -> Iterator[tuple[str, Callable[..., None]]]:
    """The name of each command, such as "progressive build", and its function."""
    for name in COMMANDS:
        command = getattr(importlib.import_module(f"warpqem.cli.{name}"), name)
        if not isinstance(command, typer.Typer):
            yield name, command
            continue
        for info in command.registered_commands:
            assert info.callback is not None
            yield f"{name} {info.name or info.callback.__name__}", info.callback
