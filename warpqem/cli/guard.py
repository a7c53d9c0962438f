"""A process that watches the one that does the work, and names what native code does to it.

Damaged files can make USD end its process, or never come back. The command line forks before it loads anything large,
which takes some milliseconds; where it cannot fork, as on Windows, the work is done in its own process.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from types import FrameType

from warpqem.cli.console import EXIT_FAILED, tell
from warpqem.opening import TIME_IS_UP, tell_openings
from warpqem.process_limits import limit_behind_signal

__all__ = ["guarded"]

# Room for the path of the file that is being opened; longer ones are cut.
PATH_BYTES = 4096
# What stands before it: whether USD is at it still.
OPENING, OPENED = b"o", b"d"
# A terminal sends Ctrl-C to both processes, and the watcher passes on what only it may have got: two within so many
# seconds are one.
SAME_INTERRUPT_SECONDS = 0.5


def guarded(work: Callable[[], None]) -> None:
    """Do something in a process of its own, and exit as it does; a signal that ends it becomes an error with a reason.

    Raises:
        SystemExit: always.
    """
    if not hasattr(os, "fork"):
        work()
        sys.exit(0)
    opened = mmap.mmap(-1, 1 + PATH_BYTES)
    alive_read, alive_write = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(alive_write)
        _work(work, opened, alive_read)
    os.close(alive_read)
    sys.exit(_watch(child, opened))


def _work(work: Callable[[], None], opened: mmap.mmap, alive: int) -> None:
    """The child: never returns."""

    def end_with_watcher() -> None:
        os.read(alive, 1)  # ends when the watcher has, however that was
        os._exit(EXIT_FAILED)

    def note(file: str, begins: bool) -> None:
        opened[:] = (OPENING if begins else OPENED) + os.fsencode(file)[:PATH_BYTES].ljust(PATH_BYTES, b"\0")

    threading.Thread(target=end_with_watcher, daemon=True).start()
    _take_interrupts_once()
    tell_openings(note)
    work()
    sys.exit(0)


def _take_interrupts_once() -> None:
    last = -SAME_INTERRUPT_SECONDS

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last > SAME_INTERRUPT_SECONDS:
            last = now
            raise KeyboardInterrupt

    signal.signal(signal.SIGINT, interrupt)


def _watch(child: int, opened: mmap.mmap) -> int:
    """Wait for the child, and tell how it ended; returns the exit code."""
    interrupts: list[float] = []

    def pass_on(number: int, frame: FrameType | None) -> None:
        again = bool(interrupts) and time.monotonic() - interrupts[-1] > SAME_INTERRUPT_SECONDS
        interrupts.append(time.monotonic())
        # Native code does not hear of the first.
        with contextlib.suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL if again else number)

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, pass_on)
    _, status = os.waitpid(child, 0)
    code = os.waitstatus_to_exitcode(status)
    if code >= 0:
        return code
    if interrupts:
        tell("error", "interrupted")
        return EXIT_FAILED
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = f"signal {-code}"
    note = bytes(opened).rstrip(b"\0")
    tell("error", _reason(name, os.fsdecode(note[1:]), is_opening=note.startswith(OPENING)))
    return EXIT_FAILED


def _reason(name: str, file: str, is_opening: bool) -> str:
    """Why the work ended by a signal; ``file`` is the last that was opened, empty for none."""
    before = f"{file}: " if file else ""
    limit = limit_behind_signal(name)
    if limit:
        return f"{before}ended by {name}, for which this is the likely reason: {limit}"
    if name == "SIGKILL":
        return f"{before}stopped from outside (SIGKILL), as systems do when memory runs out (--memory limits it)"
    if is_opening and name == TIME_IS_UP:
        return f"{before}USD does not come to the end of it; it is damaged"
    if is_opening:
        return f"{before}USD crashed while it opened the file, which is damaged ({name})"
    return f"{before}crashed in native code ({name}) after the file was opened; a damaged file can do this to USD"
