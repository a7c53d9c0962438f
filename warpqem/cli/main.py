"""The `warpqem` program. Signal handlers are set before anything else is loaded."""

from __future__ import annotations

import io
import sys
from typing import Any

__all__ = ["run"]


def run() -> None:
    """The `warpqem` program.

    Raises:
        SystemExit: always.
    """
    from warpqem.cli.signals import hold_signals

    hold_signals()
    for stream in (sys.stdout, sys.stderr):
        # A terminal of another encoding gets escapes for what it cannot show.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    from warpqem.cli.crash_guard import guarded
    from warpqem.cli.messages import EXIT_FAILED, print_message
    from warpqem.errors import ProcessLimitError
    from warpqem.runtime.process_limits import check_limits

    try:
        check_limits()
    except ProcessLimitError as error:
        print_message("error", str(error))
        sys.exit(EXIT_FAILED)
    guarded(_work)


def _work() -> None:
    from warpqem.cli.app import app
    from warpqem.cli.loading import own_process

    own_process()

    app(prog_name="warpqem")


def __getattr__(name: str) -> Any:
    """The app, imported on first use."""
    if name == "app":
        from warpqem.cli.app import app

        return app
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
