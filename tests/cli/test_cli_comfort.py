"""What makes the command line pleasant: examples that work, units, completions, no colours in a pipe."""

from __future__ import annotations

import inspect
import os
import re
import subprocess
import sys
import typing

import pytest
import typer.main
from typer.testing import CliRunner

from tests.support.commands import command_functions
from tests.support.docs import desk, run_line
from warpqem.cli.main import app

__all__ = ["desk"]

GROUP = typer.main.get_command(app)
PROGRESSIVE = GROUP.commands["progressive"].commands
FACE = GROUP.commands["face"].commands
COMMANDS = {
    **{name: command for name, command in GROUP.commands.items() if name not in ("progressive", "face")},
    "build": PROGRESSIVE["build"],
    "extract": PROGRESSIVE["extract"],
    "progressive info": PROGRESSIVE["info"],
    **{f"face {name}": command for name, command in FACE.items()},
}
# How the help of a number says what it counts.
UNITS = (
    r"%|pixels|degrees|units of the stage|seconds|SECONDS|[Tt]riangles|[Ff]aces|frames|0 to 1|[Ww]eight|Joints|joints|"
    r"Processes|How often|cores|GPUs|Pictures|sample points|[Pp]ort|twice|edges"
)


def environment(**others: str) -> dict[str, str]:
    plain = {name: value for name, value in os.environ.items() if name not in ("NO_COLOR", "FORCE_COLOR")}
    return {**plain, "TERM": "xterm-256color", **others}


def call(*arguments: str, **others: str) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "warpqem", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, env=environment(**others))


def examples(command: object) -> list[str]:
    """The lines under the help of a command."""
    title, *lines = command.epilog.split("\n\n")
    assert title == ("Examples:" if len(lines) > 1 else "Example:")
    return lines


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_examples(name):
    lines = examples(COMMANDS[name])
    assert lines
    for line in lines:
        assert f"{line} ".startswith(f"warpqem {'progressive ' if name in ('build', 'extract') else ''}{name} ")


def test_examples_run_in_their_order(desk):
    for name, command in COMMANDS.items():
        # That compiles all kernels, into a folder of its own.
        for line in () if name == "warmup" else examples(command):
            run_line(line)


@pytest.mark.parametrize("command", dict(command_functions()))
def test_every_number_says_what_it_counts(command):
    function = dict(command_functions())[command]
    for name, parameter in inspect.signature(function, eval_str=True).parameters.items():
        kind, option = typing.get_args(parameter.annotation)
        if {int, float} & {kind, *typing.get_args(kind)}:
            assert re.search(UNITS, f"{option.help} {option.metavar}"), name


@pytest.mark.parametrize("arguments", [["in.usda", "-o", "out.usda", "--ratios", "0.5"], ["--help"], []])
def test_command_that_was_removed_names_what_does_the_same(arguments):
    done = CliRunner().invoke(app, ["levels", *arguments])
    assert (done.exit_code, done.stdout) == (2, "")
    assert done.stderr == "error: warpqem levels was removed: use warpqem simplify IN -o OUT --lods RATIOS\n"


def test_help_comes_first_with_what_a_command_does():
    for name, command in COMMANDS.items():
        assert len(command.help.strip().split("\n\n")[0].splitlines()) <= 2, name


@pytest.mark.parametrize(
    ("words", "expected"),
    [("warpqem sim", "simplify"), ("warpqem progressive ex", "extract"), ("warpqem simplify --metric a", "aqem"),
     ("warpqem simplify --rep", "--report")],
)  # fmt: skip
def test_shells_complete_commands_options_and_values(words, expected):
    count = str(len(words.split()) - 1)
    done = subprocess.run(
        [sys.executable, "-c", "from warpqem.cli.main import app; app(prog_name='warpqem')"],
        env=environment(COMP_WORDS=words, COMP_CWORD=count, _WARPQEM_COMPLETE="complete_bash"),
        capture_output=True,
        text=True,
        check=False,
    )
    assert expected in done.stdout.split(), done.stderr


def test_completion_can_be_installed():
    assert "--install-completion" in CliRunner().invoke(app, ["--help"]).output


@pytest.mark.parametrize("arguments", [["--help"], ["simplify", "--help"], ["simplify", "--nonsense"]])
def test_there_are_no_colours_where_there_is_no_terminal(arguments):
    done = call(*arguments)
    assert "\x1b" not in done.stdout + done.stderr
    assert done.stdout or done.stderr


def test_tables_have_no_colours_where_there_is_no_terminal(desk):
    done = call("info", "cape_wind.usdc")
    assert done.returncode == 0, done.stderr
    assert "\x1b" not in done.stdout + done.stderr
