"""The text of ``--help``: options under heads, names beside what they do, readable at 80 columns."""

from __future__ import annotations

import inspect
import re
import typing
from collections.abc import Iterable, Mapping, Sequence
from enum import Enum
from typing import Any

from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.panel import Panel as Box
from rich.table import Table
from rich.text import Text

from warpqem.arguments.option_fields import Panel

__all__ = ["print_help"]

# Lines of more characters are hard to read.
MAX_WIDTH = 100
# Characters of names at most beside what they do; longer ones stand above it.
NAME_WIDTH = 24
# Border and blank of a panel on both sides.
FRAME = 4
HEADS: tuple[str, ...] = typing.get_args(Panel)
# Options of commands that say nothing else.
OTHERS = "Options"
COMMANDS = "Commands"
# These stand below all panels.
HELP = ("help", "help_all")
NAME_STYLE, VALUE_STYLE = "bold cyan", "yellow"


def print_help(command: Any, context: Any) -> None:
    """Print what a command, or a group of them, does and takes.

    Args:
        command: A command of click; options that are hidden are left out.
        context: Its context.
    """
    console = Console()
    console.width = min(console.width, MAX_WIDTH)
    console.print(Padding(_usage(command, context), (1, 1)))
    for paragraph in _paragraphs(command.help or ""):
        console.print(Padding(paragraph, (0, 1, 1, 1)))
    panels = _panels(command, context)
    widths = {head: _width([rows]) for head, rows in panels.items() if head == COMMANDS}
    shared = _width(rows for head, rows in panels.items() if head not in widths)
    for head, rows in panels.items():
        width = widths.get(head, shared)
        lines = [_row(name, text, width, console.width - FRAME) for name, text in rows]
        console.print(Box(Group(*lines), title=head, title_align="left", border_style="dim"))
    console.print(Padding(_about_help(command, context), (0, 1)))
    if command.epilog:
        console.print(Padding(Text("\n".join(_paragraphs(command.epilog))), (1, 1, 0, 1)))


def _width(panels: Iterable[Sequence[tuple[Text, Text]]]) -> int:
    """Characters of the names that stand beside what they do."""
    return max((len(name) for rows in panels for name, _ in rows if len(name) <= NAME_WIDTH), default=0)


def _usage(command: Any, context: Any) -> Text:
    pieces = [context.command_path]
    parameters = command.get_params(context)
    pieces += [_argument_name(parameter) for parameter in parameters if _is_argument(parameter)]
    for parameter in parameters:
        if not _is_argument(parameter) and parameter.required:
            pieces.append(f"{min(parameter.opts, key=len)} {parameter.metavar}")
    pieces += ["[OPTIONS]", *(["COMMAND", "[ARGS]..."] if hasattr(command, "commands") else [])]
    return Text.assemble("Usage: ", (" ".join(pieces), "bold"))


def _paragraphs(text: str) -> list[str]:
    """Paragraphs, each on one line."""
    return [" ".join(part.split()) for part in re.split(r"\n\s*\n", inspect.cleandoc(text)) if part.strip()]


def _panels(command: Any, context: Any) -> dict[str, list[tuple[Text, Text]]]:
    """The rows of each panel by its head, in order: those that ``--help`` shows come first in ``--help-all``."""
    found: dict[str, list[tuple[Text, Text]]] = {}
    parameters = [parameter for parameter in command.get_params(context) if not getattr(parameter, "hidden", False)]
    parameters = [parameter for parameter in parameters if parameter.name not in HELP]
    parameters.sort(key=lambda parameter: (not _is_argument(parameter), getattr(parameter, "shown_late", False)))
    for parameter in parameters:
        head = "Input" if _is_argument(parameter) else parameter.rich_help_panel or OTHERS
        name = Text(_argument_name(parameter), VALUE_STYLE) if _is_argument(parameter) else _option_name(parameter)
        found.setdefault(head, []).append((name, _what(parameter)))
    for other, summary in _summaries(command).items():
        found.setdefault(COMMANDS, []).append((Text(other, NAME_STYLE), Text(summary)))
    order = {head: rank for rank, head in enumerate(HEADS)}
    heads = sorted(found, key=lambda head: order.get(head, 0 if head == OTHERS else len(HEADS)))
    return {head: found[head] for head in heads}


def _summaries(group: Any) -> Mapping[str, str]:
    """What each command of a group does: the first paragraph of its help, unless the group has a list of them."""
    listed: Mapping[str, str] | None = getattr(group, "summaries", None)
    if listed is not None:
        return listed
    commands = {name: other for name, other in getattr(group, "commands", {}).items() if not other.hidden}
    return {name: next(iter(_paragraphs(other.help or "")), "") for name, other in commands.items()}


def _is_argument(parameter: Any) -> bool:
    return bool(parameter.param_type_name == "argument")


def _argument_name(parameter: Any) -> str:
    return str(parameter.metavar or parameter.name.upper())


def _option_name(parameter: Any) -> Text:
    long = [name for name in (*parameter.opts, *parameter.secondary_opts) if name.startswith("--")]
    short = [name for name in (*parameter.opts, *parameter.secondary_opts) if not name.startswith("--")]
    name = Text(", ".join([*short, *long]), NAME_STYLE)
    return name if parameter.metavar is None else name.append(f" {parameter.metavar}", VALUE_STYLE)


def _what(parameter: Any) -> Text:
    text = Text(" ".join((parameter.help or "").split()))
    if parameter.required and not _is_argument(parameter):
        text.append(" [required]", "red")
    default = _default(parameter)
    return text.append(f" [default: {default}]", "dim") if default else text


def _default(parameter: Any) -> str:
    """What is taken where an option is not given; empty for nothing."""
    default = parameter.default.value if isinstance(parameter.default, Enum) else parameter.default
    if isinstance(default, bool):
        return str(parameter.opts[0]) if default and parameter.secondary_opts else ""
    if isinstance(default, float):
        return f"{default:g}"
    return str(default) if isinstance(default, (str, int)) and default not in ("", 0) else ""


def _row(name: Text, text: Text, width: int, room: int) -> RenderableType:
    """A name and what it does: beside each other, or below where the name is long."""
    indent = width + 2
    if len(name) > width:
        return Group(name, Padding(text, (0, 0, 0, indent)))
    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_column(width=width, no_wrap=True)
    table.add_column(width=room - indent)
    table.add_row(name, text)
    return table


def _about_help(command: Any, context: Any) -> Text:
    parameters: Sequence[Any] = command.get_params(context)
    names: Iterable[str] = (name for parameter in parameters if parameter.name in HELP for name in parameter.opts)
    shown = sorted(set(names), key=len)
    hidden = sum(bool(getattr(parameter, "hidden", False)) for parameter in parameters)
    if hidden:
        return Text(f"{shown[0]} shows this, {shown[-1]} {hidden} more options.")
    return Text(f"{' and '.join(shown)} show this.")
