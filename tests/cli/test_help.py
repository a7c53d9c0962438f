"""`--help`: short, under heads, without the types of flags, and readable at 80 columns."""

from __future__ import annotations

import re
import subprocess
import sys
import typing

import pytest
import typer.main

from tests.support.cli import run
from warpqem.arguments.option_fields import Panel, named_options
from warpqem.cli.app import COMMANDS as LISTED
from warpqem.cli.main import app
from warpqem.usd import SimplifyOptions
from warpqem.usd.commands.progressive_options import BuildOptions, LevelChoice

HEADS = typing.get_args(Panel)
NAME = r"^│ (?:-\w, )?(--[a-z-]+)"


def all_commands(group: typing.Any, *path: str) -> dict[tuple[str, ...], typing.Any]:
    found = {path: group}
    for name, command in getattr(group, "commands", {}).items():
        found |= all_commands(command, *path, name)
    return found


COMMANDS = all_commands(typer.main.get_command(app))


def shown(*arguments: str, columns: int = 80) -> str:
    return run(*arguments, env={"COLUMNS": str(columns)}).stdout


def plain(text: str) -> str:
    """Without the lines of panels and with blanks for all space."""
    return " ".join(re.sub("[│╭╰─╮╯]", " ", text).split())


def heads(text: str) -> list[str]:
    return re.findall(r"^╭─ (.*?) ─", text, re.MULTILINE)


def test_help_of_simplify_is_a_screen_and_help_all_is_whole():
    short, whole = shown("simplify", "--help"), shown("simplify", "--help-all")
    assert len(short.splitlines()) <= 60
    assert len(re.findall(NAME, short, re.MULTILINE)) <= 12
    assert "--memoryless" not in short
    assert "best orders by the present faces" in plain(whole)
    assert len(re.findall(NAME, whole, re.MULTILINE)) >= 55


def test_options_stand_under_heads():
    assert heads(shown("simplify", "--help-all")) == list(HEADS)
    assert set(heads(shown("batch", "--help-all"))) == set(HEADS)
    short = shown("simplify", "--help")
    assert heads(short) == [head for head in HEADS if head not in ("What to keep", "Machine")]
    parts = dict(zip(heads(short), re.split(r"^╭", short, flags=re.MULTILINE)[1:], strict=True))
    for head, names in {
        "Goal": ["--ratio", "--faces"],
        "Levels": ["--lods"],
        "Output": ["--output", "--report"],
    }.items():
        for name in names:
            assert name in parts[head]


@pytest.mark.parametrize("options", [SimplifyOptions, BuildOptions, LevelChoice])
def test_every_option_says_under_which_head_it_stands(options):
    for name, entry in named_options(options).items():
        assert entry.option.panel in HEADS, name


@pytest.mark.parametrize("path", COMMANDS, ids=" ".join)
@pytest.mark.parametrize("columns", [80, 100])
def test_help_shows_names_whole_no_types_and_no_line_that_is_too_long(path, columns):
    for flag in ("--help", "--help-all"):
        text = shown(*path, flag, columns=columns)
        assert max(map(len, text.splitlines())) <= columns
        assert not re.search(r"<\w+(\[\w+\])?>|…", text)
    options = [parameter for parameter in COMMANDS[path].params if parameter.param_type_name == "option"]
    for option in options:
        names = [name for name in (*option.opts, *option.secondary_opts) if name.startswith("--")]
        assert all(name in text for name in names), names


@pytest.mark.parametrize("path", [path for path, command in COMMANDS.items() if not hasattr(command, "commands")])
def test_whatever_takes_a_value_names_it(path):
    for option in COMMANDS[path].params:
        if option.param_type_name == "option" and option.name not in ("help", "help_all"):
            is_flag = option.is_flag or getattr(option, "count", False)
            assert bool(option.metavar) != bool(is_flag), option.opts


def test_usage_names_what_is_required():
    assert "Usage: warpqem simplify IN -o OUT [OPTIONS]" in plain(run("simplify", "--help", name="warpqem").stdout)
    assert "Usage: warpqem compare REFERENCE TEST [OPTIONS]" in plain(run("compare", "--help", name="warpqem").stdout)


@pytest.mark.parametrize(
    ("command", "option", "text"),
    [
        ("simplify", "--ratio", "Share of its triangles that each mesh keeps"),
        ("progressive extract", "--ratio", "Share of the input's triangles"),
        ("simplify", "--prim", "Only the meshes at and below this prim path"),
        ("progressive build", "--prim", "needed where IN has more than one"),
        ("face simplify", "--faces", "Triangles"),
        ("simplify", "--max-size-error", "A mesh stops where the estimate of its error would pass"),
        ("batch", "--max-size-error", "where the estimate of its error"),
    ],
)
def test_an_option_of_two_commands_has_the_help_of_each(command, option, text):
    whole = plain(shown(*command.split(), "--help-all"))
    about = re.split(rf"{option} [A-Z]+ ", whole, maxsplit=1)[1]
    assert text in about.split(" --")[0]


def test_defaults_are_shown_and_flags_that_are_on_by_name():
    whole = plain(shown("simplify", "--help-all"))
    for name, default in (("--quality", "best"), ("--key-frames", "16"), ("--weld", "--weld"), ("--fov", "45")):
        about = re.split(rf"{name}(?:, --no-\w+| [^ ]+) (?=[A-Za-z])", whole, maxsplit=1)[1]
        assert f"[default: {default}]" in re.split(r"\] --", about)[0] + "]", name
    assert "[default: 0]" not in whole


def test_the_list_of_all_commands_says_what_each_says_itself():
    for name, summary in LISTED.items():
        paragraph = COMMANDS[name,].help.split("\n\n")[0]
        assert plain(paragraph) == summary
    assert list(LISTED) == list(typer.main.get_command(app).commands)


def test_help_of_all_loads_no_command():
    code = """
import sys
from typer.testing import CliRunner
from warpqem.cli.app import COMMANDS, app
assert "simplify" in CliRunner().invoke(app, ["--help"]).output
print([name for name in COMMANDS if f"warpqem.cli.{name}" in sys.modules], "rich.progress" in sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["[]", "False"]
