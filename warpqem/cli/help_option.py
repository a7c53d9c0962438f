"""``--help`` of every command, which is ``--help-all`` as well where no options are left to that."""

from __future__ import annotations

from typing import Any

import typer.core

from warpqem.cli.help_text import print_help

__all__ = ["HELP_NAMES", "Command", "Group"]

# Settings of the first context, which those of all commands take over. A command with ``--help-all`` of its own
# (:mod:`warpqem.cli.option_parameters`) keeps that.
HELP_NAMES = {"help_option_names": ["--help", "--help-all"]}


class Command(typer.core.TyperCommand):
    """A command whose help is that of `warpqem.cli.help_text`, with its names in one order."""

    def get_help_option_names(self, ctx: Any) -> list[str]:
        """The names, which come from a set."""
        return sorted(super().get_help_option_names(ctx))

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print the help."""
        print_help(self, ctx)


class Group(typer.core.TyperGroup):
    """A group of commands with the same help."""

    def get_help_option_names(self, ctx: Any) -> list[str]:
        """The names, which come from a set."""
        return sorted(super().get_help_option_names(ctx))

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print the help."""
        print_help(self, ctx)
