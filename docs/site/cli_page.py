"""The page of the command line, made from the commands and their options."""

from __future__ import annotations

import contextlib
import io
import re
import typing
from collections.abc import Iterator
from enum import Enum
from typing import Any

import typer.main

from warpqem.arguments.option_fields import Panel
from warpqem.cli.app import app

__all__ = ["cli_page"]

PROGRAM = "warpqem"
# These are on every command, and the page says so once.
HELP = ("help", "help_all")
INTRODUCTION = """# Command line

Every command with every option, made from the program; the same as `warpqem COMMAND --help-all`. What `--help` shows,
as most need no more, is in **bold**. Guides: [USD pipelines](pipeline.md), [many assets](batch.md).
"""


def cli_page() -> str:
    """The text of the page."""
    group = typer.main.get_command(app)
    parts = [INTRODUCTION, _plain(group.epilog or "")]
    for path, command in _commands(group, ()):
        shown = {parameter.name for parameter in command.params if not getattr(parameter, "hidden", False)}
        _take_full_help(group, path)
        parts += _section(path, command, shown)
    return "\n\n".join(parts) + "\n"


def _commands(group: Any, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any]]:
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from _commands(command, (*path, name))
        else:
            yield (*path, name), command


def _take_full_help(group: Any, path: tuple[str, ...]) -> None:
    """Give the options of a command their full help, as its ``--help-all`` does."""
    with contextlib.redirect_stdout(io.StringIO()):
        group.main([*path, "--help-all"], prog_name=PROGRAM, standalone_mode=False)


def _section(path: tuple[str, ...], command: Any, shown: set[str]) -> list[str]:
    parameters = [parameter for parameter in command.params if parameter.name not in HELP]
    arguments = [parameter for parameter in parameters if parameter.param_type_name == "argument"]
    options = [parameter for parameter in parameters if parameter.param_type_name != "argument"]
    required = [f"{min(option.opts, key=len)} {option.metavar}" for option in options if option.required]
    usage = " ".join([PROGRAM, *path, *map(_argument, arguments), *required, "[OPTIONS]"])
    parts = [f"## {PROGRAM} {' '.join(path)}", _plain(command.help or ""), f"```text\n{usage}\n```"]
    if arguments:
        parts.append(_table("argument", [(f"`{_argument(row)}`", _what(row)) for row in arguments]))
    # In the order of the help; what has no head stands first.
    heads: dict[str, list[Any]] = {head: [] for head in ("", *typing.get_args(Panel))}
    for option in options:
        heads.setdefault(option.rich_help_panel or "", []).append(option)
    for head, members in heads.items():
        if not members:
            continue
        members.sort(key=lambda option: option.name not in shown)
        rows = [(_names(option, option.name in shown), _what(option)) for option in members]
        parts += [f"**{head}**"] * bool(head) + [_table("option", rows)]
    # What stands under the help; tests run it.
    examples = [line.strip() for line in (command.epilog or "").splitlines() if line.strip().startswith(PROGRAM)]
    return [*parts, "Examples:", "```text\n" + "\n".join(examples) + "\n```"] if examples else parts


def _argument(parameter: Any) -> str:
    return str(parameter.metavar or parameter.name.upper())


def _names(option: Any, bold: bool) -> str:
    names = sorted((*option.opts, *option.secondary_opts), key=lambda name: not name.startswith("--"))
    text = " ".join(f"`{name}`" for name in names)
    return f"**{text}**{_value(option)}" if bold else f"{text}{_value(option)}"


def _value(option: Any) -> str:
    """What stands for the value of an option; nothing for flags and what is counted."""
    if getattr(option, "is_flag", False) or getattr(option, "count", False):
        return ""
    # Typer's own description of types has taken the place of click's.
    kind = getattr(option, "type_descriptor", None) or option.type
    choices = [getattr(choice, "value", choice) for choice in getattr(kind, "choices", None) or ()]
    given = (option.metavar or "").split("|") if "|" in (option.metavar or "") else [option.metavar or "NUMBER"]
    # Several names may stand below each other.
    return " " + " \\| ".join(f"`{name}`" for name in choices or given)


def _what(parameter: Any) -> str:
    text = _plain(parameter.help or "")
    if parameter.required and parameter.param_type_name != "argument":
        text += " *Required.*"
    default = parameter.default.value if isinstance(parameter.default, Enum) else parameter.default
    # What is counted, as -v is, is counted from nothing.
    none = isinstance(default, bool) or default in (None, "", (), []) or callable(default)
    if none or parameter.required or getattr(parameter, "count", False):
        return text
    return f"{text} *Default:* `{default:g}`." if isinstance(default, float) else f"{text} *Default:* `{default}`."


def _table(head: str, rows: list[tuple[str, str]]) -> str:
    lines = [f"| {head} | what it does |", "|---|---|", *(f"| {name} | {what} |" for name, what in rows)]
    return "\n".join(lines)


def _plain(text: str) -> str:
    """Text of a help as Markdown: names of options as code, and nothing that Markdown or HTML would read as marks."""
    text = " ".join(text.split())
    text = re.sub(r"([<>*_|\[\]{}])", r"\\\1", text)
    return re.sub(r"(?<![\w`-])(--?[a-z][a-z-]*)", r"`\1`", text)
