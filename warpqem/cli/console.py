"""What all commands share: where text goes, progress, JSON, and errors as one line."""

from __future__ import annotations

import json
import os
import sys
import traceback
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
import typer.core

from warpqem.cli import messages
from warpqem.cli.flag_names import error_text, flags_of
from warpqem.cli.messages import EXIT_FAILED, EXIT_INTERRUPTED, EXIT_USAGE, print_message, printed_messages
from warpqem.cli.number_parameters import usage_text
from warpqem.errors import OptionError, StageError, WarpqemError
from warpqem.printable import printable_lines
from warpqem.runtime.process_limits import limit_behind_error, with_limit

if TYPE_CHECKING:
    from warpqem.usd.checks.usd_errors import UsdMessages
from warpqem.files.temporary import replacing

__all__ = [
    "EXIT_FAILED",
    "EXIT_INTERRUPTED",
    "EXIT_USAGE",
    "OneLineErrors",
    "load_usd",
    "print_message",
    "quiet_libraries",
    "write_json",
]

# Set to anything, an error that is a defect of warpqem or of the machine comes with its traceback.
TRACEBACK_VARIABLE = "WARPQEM_TRACEBACK"

# Warnings of USD that a command shows at its end; a clip that is missing gives one for each frame.
MAX_WARNINGS = 20

_usd_messages: UsdMessages | None = None


class OneLineErrors(typer.core.TyperGroup):
    """A command group that prints errors as one line `error: ...` on stderr and exits with 1, or 2 for wrong usage."""

    def invoke(self, ctx: Any) -> Any:
        """Run a command; versions of Typer differ in what they make of Ctrl-C."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            print_message("error", "interrupted")
            raise typer.Exit(EXIT_INTERRUPTED) from None

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
        messages.quiet = False
        if not (sys.argv[1:] if args is None else args):
            args = ["--help"]
        if not standalone_mode:
            return super().main(args, prog_name, complete_var, False, windows_expand_args, **extra)
        try:
            code = self._run(args, prog_name, complete_var, windows_expand_args, **extra)
        finally:
            print_usd_warnings()
        sys.exit(code if isinstance(code, int) else 0)

    def _run(
        self,
        args: Sequence[str] | None,
        prog_name: str | None,
        complete_var: str | None,
        windows_expand_args: bool,
        **extra: Any,
    ) -> Any:
        try:
            return super().main(args, prog_name, complete_var, False, windows_expand_args, **extra)
        except OptionError as error:
            print_message("error", error_text(error, flags_of(self, sys.argv[1:] if args is None else args)))
            return EXIT_USAGE
        except WarpqemError as error:
            flags = flags_of(self, sys.argv[1:] if args is None else args)
            print_message("error", with_limit(error_text(error, flags), error))
        except MemoryError as error:
            print_message("error", with_limit("out of memory", error))
        except typer.Abort:
            print_message("error", "interrupted")
            return EXIT_INTERRUPTED
        except Exception as error:
            # Typer has its own copy of click since 0.26, so its usage errors are known by what they offer.
            if hasattr(error, "format_message"):
                print_message("error", f"{usage_text(error.format_message())} (see warpqem --help)")
                return EXIT_USAGE
            limit = limit_behind_error(error)
            if os.environ.get(TRACEBACK_VARIABLE):
                print(printable_lines(traceback.format_exc()), file=sys.stderr)
            else:
                text = " ".join(str(error).split())
                if limit:
                    print_message("error", f"{limit}: {text}")
                    return EXIT_FAILED
                print_message("error", f"{type(error).__name__}: {text} (set {TRACEBACK_VARIABLE}=1 for a traceback)")
        return EXIT_FAILED


def print_usd_warnings() -> None:
    """Print what USD has warned of, but for what the command has printed itself, and listen no longer."""
    global _usd_messages
    warnings = [] if _usd_messages is None else _usd_messages.take()
    _usd_messages = None
    warnings = [text for text in warnings if not any(t and (text in t or t in text) for t in printed_messages)]
    printed_messages.clear()
    for text in warnings[:MAX_WARNINGS]:
        print_message("warning", text)
    if len(warnings) > MAX_WARNINGS:
        print_message("warning", f"and {len(warnings) - MAX_WARNINGS} more of USD")
    printed_messages.clear()


class _WarpMessages:
    """Warp's messages as lines on stderr, but for those about modules and devices."""

    def debug(self, message: str) -> None:
        pass

    def info(self, message: str) -> None:
        pass

    def warning(self, message: str, category: type[Warning] | None = None, stacklevel: int = 1) -> None:
        print_message("warning", " ".join(message.split()))

    def error(self, message: str) -> None:
        print_message("error", " ".join(message.split()))


def load_usd() -> None:
    """Load USD for a command that reads or writes stages, and make lines of its messages at the command's end.

    Raises:
        UsdLibraryError: it is missing, broken or too old.
    """
    global _usd_messages
    from warpqem.usd.checks.library import need_usd

    need_usd()
    from warpqem.usd.checks.usd_errors import UsdMessages

    _usd_messages = _usd_messages or UsdMessages()


def _show_warning(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
    print_message("warning", " ".join(str(message).split()))


def quiet_libraries() -> None:
    """Keep Warp's messages off stdout, which belongs to the command's result, and make lines of Python's warnings."""
    import warp

    warnings.showwarning = _show_warning
    warp.config.log_level = warp.LOG_INFO
    warp.set_logger(_WarpMessages())


def write_json(target: str, value: Any) -> None:
    """Write JSON to a file, or to stdout for `-`.

    Raises:
        StageError: the file cannot be written.
    """
    text = json.dumps(value, indent=2, allow_nan=False) + "\n"
    if target == "-":
        sys.stdout.write(text)
        return
    path = Path(target)
    try:
        if path.exists() and not path.is_file():  # a pipe or a device
            path.write_text(text, encoding="utf-8")
            return
        # Where the file is a link, what it leads to is replaced.
        with replacing(path.resolve()) as temporary:
            temporary.write_text(text, encoding="utf-8")
    except OSError as error:
        raise StageError(f"{target}: cannot be written ({error.strerror})") from error
