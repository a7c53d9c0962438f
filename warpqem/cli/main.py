"""The `warpqem` program. Nothing is loaded before it knows what to do with signals."""

from __future__ import annotations

from typing import Any

__all__ = ["run"]


def run() -> None:
    """The `warpqem` program.

    Raises:
        SystemExit: always.
    """
    from warpqem.cli.signals import hold_signals

    hold_signals()
    from warpqem.cli.guard import guarded

    guarded(_work)


def _work() -> None:
    from warpqem.cli.app import app

    app(prog_name="warpqem")


def __getattr__(name: str) -> Any:
    """The app, loaded when somebody asks for it."""
    if name == "app":
        from warpqem.cli.app import app

        return app
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
