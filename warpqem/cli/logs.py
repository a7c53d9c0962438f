"""Logging on the command line."""

from __future__ import annotations

import functools
import inspect
import json
import logging
import sys
import time
from collections.abc import Callable
from typing import Annotated, Any

import typer

from warpqem.cli import messages
from warpqem.cli.option_parameters import check_names
from warpqem.errors import OptionError, StageError
from warpqem.printable import printable, printable_lines

__all__ = ["LogJson", "start_logging", "takes_verbosity"]

LEVELS = (logging.WARNING, logging.INFO, logging.DEBUG)


def takes_verbosity(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command --quiet and --verbose, which exclude each other; it gets those that it names itself.

    Where it has --help-all, its help leaves them to that.
    """
    own = inspect.signature(command, eval_str=True)
    hidden = "help_all" in own.parameters
    flags = {
        "quiet": (bool, False, _option("--quiet", "-q", hidden, "Print errors alone.")),
        "verbose": (
            int,
            0,
            _option("--verbose", "-v", hidden, "Say on stderr what is being done; twice: in detail.", count=True),
        ),
    }
    shared = [
        inspect.Parameter(
            name, inspect.Parameter.POSITIONAL_OR_KEYWORD, default=default, annotation=Annotated[kind, about]
        )
        for name, (kind, default, about) in flags.items()
    ]

    @functools.wraps(command)
    def wrapper(**arguments: Any) -> None:
        check_names(own.parameters, arguments)
        quiet, verbose = arguments.pop("quiet"), arguments.pop("verbose")
        if quiet and verbose:
            raise OptionError("`quiet` and `verbose` exclude each other")
        messages.quiet = quiet
        start_logging(verbose, None)
        asked = {"quiet": quiet, "verbose": verbose}
        command(**arguments, **{name: value for name, value in asked.items() if name in own.parameters})

    parameters = [parameter for name, parameter in own.parameters.items() if name not in flags] + shared
    # Typer reads both.
    wrapper.__signature__ = own.replace(parameters=parameters)  # type: ignore[attr-defined]  # PEP 362
    wrapper.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return wrapper


def _option(name: str, short: str, hidden: bool, text: str, count: bool = False) -> Any:
    return typer.Option(name, short, hidden=hidden, count=count, rich_help_panel="Output", help=text)


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
