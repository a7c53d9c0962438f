"""What all commands share: where text goes, progress, JSON, and errors as one line."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import typer
import typer.core
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from warpqem.errors import OptionError, StageError, WarpqemError

__all__ = [
    "EXIT_FAILED",
    "EXIT_USAGE",
    "OneLineErrors",
    "QuietProgress",
    "load_usd",
    "print_table",
    "progress_bar",
    "quiet_warp",
    "tell",
    "write_json",
]

# Where output goes to a file or a pipe, lines may be as long as a table needs, within reason.
WIDEST = 1000

# Set to anything, an error that is a defect of warpqem or of the machine comes with its traceback.
TRACEBACK_VARIABLE = "WARPQEM_TRACEBACK"

EXIT_FAILED = 1
EXIT_USAGE = 2


class OneLineErrors(typer.core.TyperGroup):
    """A command group that prints errors as one line `error: ...` on stderr and exits with 1, or 2 for wrong usage."""

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        windows_expand_args: bool = True,
        **extra: Any,
    ) -> Any:
        """Run a command and turn its errors into exit codes."""
        if not standalone_mode:
            return super().main(args, prog_name, complete_var, False, windows_expand_args, **extra)
        try:
            code = super().main(args, prog_name, complete_var, False, windows_expand_args, **extra)
        except OptionError as error:
            tell("error", str(error))
            code = EXIT_USAGE
        except WarpqemError as error:
            tell("error", str(error))
            code = EXIT_FAILED
        except typer.Abort:
            tell("error", "interrupted")
            code = EXIT_FAILED
        except Exception as error:
            # Typer has carried its own copy of click since 0.26, so its usage errors are known by what they offer.
            if hasattr(error, "format_message"):
                tell("error", f"{error.format_message()} (see warpqem --help)")
                code = EXIT_USAGE
            elif os.environ.get(TRACEBACK_VARIABLE):
                raise
            else:
                tell("error", f"{type(error).__name__}: {error} (set {TRACEBACK_VARIABLE}=1 for a traceback)")
                code = EXIT_FAILED
        sys.exit(code if isinstance(code, int) else 0)


def tell(kind: str, message: str) -> None:
    """Print one line, such as `error: ...` or `warning: ...`, on stderr."""
    print(f"{kind}: {' '.join(message.split())}", file=sys.stderr)


class _WarpMessages:
    """Warp's messages as lines on stderr; of those about modules and devices only that kernels are being compiled."""

    def __init__(self) -> None:
        self._told = False

    def debug(self, message: str) -> None:
        pass

    def info(self, message: str) -> None:
        # Warp says so for each module when it has been compiled, so this comes after the first of about ten.
        if "(compiled)" in message and not self._told:
            self._told = True
            tell("note", "compiling the kernels, which takes some seconds the first time on a device")

    def warning(self, message: str, category: type[Warning] | None = None, stacklevel: int = 1) -> None:
        tell("warning", message)

    def error(self, message: str) -> None:
        tell("error", message)


def load_usd() -> None:
    """Load USD for a command that reads or writes stages.

    Raises:
        UsdLibraryError: it is missing, broken or too old.
    """
    from warpqem.usd.library import need_usd

    need_usd()


def quiet_warp() -> None:
    """Keep Warp's messages off stdout, which belongs to the command's result; say when it compiles."""
    import warp

    warp.config.log_level = warp.LOG_INFO
    warp.set_logger(_WarpMessages())


class QuietProgress(Progress):
    """A progress display that writes nothing where it is disabled; before rich 14.3 its end is an empty line."""

    def stop(self) -> None:
        """Stop the display, if there is one."""
        if not self.disable:
            super().stop()


@contextmanager
def progress_bar(first_text: str) -> Iterator[Callable[[float, str], None]]:
    """Show a progress bar on stderr; nothing if stderr is not a terminal.

    Yields:
        A function that takes the fraction done and what is being done.
    """
    console = Console(stderr=True)
    columns = [BarColumn(), TaskProgressColumn(), TimeElapsedColumn(), TextColumn("{task.description}", markup=False)]
    with QuietProgress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(first_text, total=1.0)
        yield lambda fraction, text: progress.update(task, completed=fraction, description=text)


def print_table(table: Table, to_stderr: bool = False) -> None:
    """Print a table, by default on stdout; where that is not a terminal, as wide as it needs to be."""
    console = Console(stderr=to_stderr)
    if not console.is_terminal:
        console.width = console.measure(table, options=console.options.update(max_width=WIDEST)).maximum
    console.print(table)


def write_json(target: str, value: Any) -> None:
    """Write JSON to a file, or to stdout for `-`.

    Raises:
        StageError: the file cannot be written.
    """
    text = json.dumps(value, indent=2, allow_nan=False) + "\n"
    if target == "-":
        sys.stdout.write(text)
        return
    try:
        Path(target).write_text(text, encoding="utf-8")
    except OSError as error:
        raise StageError(f"{target}: cannot be written ({error.strerror})") from error
