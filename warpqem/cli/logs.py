"""Logging on the command line."""

from __future__ import annotations

import json
import logging
import sys
import time
from typing import Annotated, Any

import typer

from warpqem.cli import messages
from warpqem.errors import StageError
from warpqem.printable import printable, printable_lines

__all__ = ["LogJson", "Quiet", "ShownQuiet", "Verbose", "start_logging"]

LEVELS = (logging.WARNING, logging.INFO, logging.DEBUG)


def _be_quiet(wanted: bool) -> bool:
    messages.quiet = wanted
    return wanted


def _quiet(hidden: bool) -> Any:
    return typer.Option(
        "--quiet", "-q", hidden=hidden, callback=_be_quiet, rich_help_panel="Output", help="Print errors alone."
    )


# Of commands with --help-all, and of the others.
Quiet = Annotated[bool, _quiet(hidden=True)]
ShownQuiet = Annotated[bool, _quiet(hidden=False)]

Verbose = Annotated[
    int,
    typer.Option(
        "--verbose",
        "-v",
        hidden=True,
        count=True,
        rich_help_panel="Output",
        help="Say on stderr what is being done; twice: in detail.",
    ),
]

LogJson = Annotated[
    str | None,
    typer.Option(
        "--log-json",
        hidden=True,
        metavar="FILE",
        rich_help_panel="Output",
        help="Append a line of JSON for everything that is being done to FILE.",
    ),
]


class _PrintableLines(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        text = f"{record.levelname}: {printable(record.getMessage())}"
        return "\n".join([text, *filter(None, [printable_lines(_traceback_of(record))])])


def _traceback_of(record: logging.LogRecord) -> str:
    """The traceback of a record, also of one from a worker of a batch; empty for none."""
    own = logging.Formatter().formatException(record.exc_info) if record.exc_info else ""
    return own or getattr(record, "traceback", "")


class _JsonLines(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        value = {
            "time": time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(record.created)) + f".{int(record.msecs):03d}Z",
            "level": record.levelname,
            "logger": record.name,
            "message": record.getMessage(),
        }
        traceback = _traceback_of(record)
        if traceback:
            value["traceback"] = traceback
        return json.dumps(value)


def start_logging(verbose: int, path: str | None) -> None:
    """Let the records of warpqem go to stderr, and all of them to a file.

    Args:
        verbose: 0 for warnings, 1 for steps, 2 or more for details.
        path: The file; None for none.

    Raises:
        StageError: the file cannot be written.
    """
    logger = logging.getLogger("warpqem")
    for handler in logger.handlers[:]:
        logger.removeHandler(handler)
    to_stderr = logging.StreamHandler(sys.stderr)
    to_stderr.setLevel(LEVELS[min(verbose, len(LEVELS) - 1)])
    to_stderr.setFormatter(_PrintableLines())
    handlers: list[logging.Handler] = [to_stderr]
    if path is not None:
        try:
            handlers.append(logging.FileHandler(path, encoding="utf-8"))
        except OSError as error:
            raise StageError(f"{path}: cannot be written ({error.strerror})") from error
        handlers[-1].setFormatter(_JsonLines())
    for handler in handlers:
        logger.addHandler(handler)
    logger.setLevel(logging.DEBUG if path is not None else to_stderr.level)
    logger.propagate = False
