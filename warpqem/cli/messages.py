"""Lines on stderr and exit codes, without loading anything: a command may have to stop before it has begun."""

from __future__ import annotations

import sys

__all__ = ["EXIT_FAILED", "EXIT_INTERRUPTED", "EXIT_SIGNAL", "EXIT_USAGE", "print_message", "printed_messages"]

EXIT_FAILED = 1
EXIT_USAGE = 2
# A command that a signal ends exits as shells show it: this and the signal's number.
EXIT_SIGNAL = 128
# The signal of Ctrl-C has the number 2 everywhere.
EXIT_INTERRUPTED = EXIT_SIGNAL + 2

# Messages printed since USD's warnings were shown last.
printed_messages: list[str] = []
# With --quiet errors alone are printed.
quiet = False


def print_message(kind: str, message: str) -> None:
    """Print one line, such as `error: ...` or `warning: ...`, on stderr."""
    from warpqem.printable import printable

    printed_messages.append(message)
    if quiet and kind != "error":
        return
    print(f"{kind}: {printable(message.strip())}", file=sys.stderr)
