"""The command line, run in this process."""

from __future__ import annotations

from typer.testing import CliRunner, Result

from warpqem.cli.main import app


def run(*arguments: object, env: dict[str, str] | None = None, name: str | None = None) -> Result:
    """The outcome of a command; ``name`` is what the help calls the program."""
    more = {} if name is None else {"prog_name": name}
    return CliRunner().invoke(app, [str(argument) for argument in arguments], env=env, **more)
