"""The command line, run in this process."""

from __future__ import annotations

from typer.testing import CliRunner, Result

from warpqem.cli.main import app


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])
