"""A process that watches the one that does the work, names what ends it, and removes what it leaves.

Damaged files can make USD end its process, or never come back, and signals come at any moment, also within native code
that no exception interrupts. So the command line forks before it loads anything large, which takes some milliseconds.
The first process, the watcher, gets the signals and ends the other one, wherever it is. Then it ends that one's worker
processes and removes its temporary files, by the record that the work keeps. Where it cannot fork, as on Windows, the
work is done in its own process.
"""

from __future__ import annotations

import contextlib
import gc
import mmap
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

from warpqem.cli.cleanup_record import WorkRecord
from warpqem.cli.messages import EXIT_FAILED, EXIT_SIGNAL, print_message
from warpqem.cli.signals import STOP_SIGNALS, handle_signals, ignore_signals
from warpqem.cli.streams import ToleratedOutput
from warpqem.runtime.load_timeout import TIME_IS_UP, report_loading
from warpqem.runtime.process_limits import limit_behind_signal
from warpqem.runtime.processes import own_id

__all__ = ["guarded", "interruptible"]

# Two of the same within so many seconds are one: `timeout` and others signal a process, and then its group.
SAME_SIGNAL_SECONDS = 0.5
# Work that is asked to end by itself is ended after so many seconds: less than the 10 that containers are given.
END_SECONDS = 8.0
# On a terminal: to the start of the line, which is cleared, and the cursor shown, which progress bars hide.
RESET_LINE = "\r\x1b[2K\x1b[?25h"


class _Page:
    """Memory that both processes share.

    Its bytes are whether USD is opening a file, whether the work ends by itself when it gets a signal, a signal that
    has ended it, and the path of the file that was opened last; longer paths are cut.
    """

    SIZE = 3 + 4096

    def __init__(self) -> None:
        self._bytes = mmap.mmap(-1, self.SIZE)

    def note_file(self, file: str, begins: bool) -> None:
        self._bytes[0] = begins
        self._bytes[3:] = os.fsencode(file)[: self.SIZE - 3].ljust(self.SIZE - 3, b"\0")

    @property
    def file(self) -> str:
        return os.fsdecode(self._bytes[3:].rstrip(b"\0"))

    @property
    def is_opening(self) -> bool:
        return bool(self._bytes[0])

    @property
    def ends_itself(self) -> bool:
        return bool(self._bytes[1])

    @ends_itself.setter
    def ends_itself(self, value: bool) -> None:
        self._bytes[1] = value

    @property
    def signal(self) -> int:
        return self._bytes[2]

    @signal.setter
    def signal(self, value: int) -> None:
        self._bytes[2] = value


# The page of a process that is watched.
_page: _Page | None = None


def guarded(work: Callable[[], None]) -> None:
    """Do something in a process of its own, and exit as it does; a signal that ends it becomes an error with a reason.

    Raises:
        SystemExit: always.
    """
    if not hasattr(os, "fork"):
        work()
        sys.exit(0)
    page, record = _Page(), WorkRecord()
    alive_read, alive_write = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(alive_write)
        _work(work, page, record, alive_read)
    os.close(alive_read)
    sys.exit(_Watcher(child, page, record).watch())


@contextmanager
def interruptible() -> Iterator[None]:
    """Let the first signal that ends a command be a KeyboardInterrupt within, for work that has something to say then.

    It has some seconds to end. Elsewhere a command that is watched is ended at once; one that is not watched gets
    KeyboardInterrupt as in any Python program.
    """
    if _page is None:
        yield
        return
    _page.ends_itself = True
    try:
        yield
    finally:
        # Once it has been interrupted, the rest is a part of its end.
        _page.ends_itself = bool(_page.signal)


def _work(work: Callable[[], None], page: _Page, record: WorkRecord, alive: int) -> NoReturn:
    """The child: never returns."""
    global _page
    _page = page

    def end_with_watcher() -> None:
        os.read(alive, 1)  # ends when the watcher has, however that was
        _end_by_fork(record)

    threading.Thread(target=end_with_watcher, daemon=True).start()
    handle_signals(_end_work)
    record.begin()
    report_loading(page.note_file)
    output = ToleratedOutput()
    code: str | int | None = 0
    try:
        work()
    except SystemExit as stop:
        code = stop.code
    finally:
        ignore_signals()
        lost = output.finish(quiet=bool(code))
    # At its end Python looks through all that was loaded for garbage: a third of the time of a small command.
    gc.freeze()
    sys.exit(code or lost)


def _end_by_fork(record: WorkRecord) -> NoReturn:
    """End this process at once; another process, which outlives it, removes its temporary files."""
    work = own_id()
    try:
        is_other = os.fork() == 0
    except OSError:  # no memory, or no more processes
        os._exit(EXIT_FAILED)
    if not is_other:
        # The other threads go on until it comes.
        time.sleep(END_SECONDS)
        os._exit(EXIT_FAILED)
    with contextlib.suppress(OSError):
        os.kill(work.number, signal.SIGKILL)
    while work.is_alive():
        time.sleep(0.001)
    record.clear()
    os._exit(EXIT_FAILED)


def _end_work(number: int, frame: FrameType | None) -> None:
    """The child has got a signal, from the watcher or from elsewhere."""
    assert _page is not None
    if not _page.ends_itself:
        _page.signal = number
        os.kill(os.getpid(), signal.SIGKILL)
    # A second one is the watcher's business: an exception while another one is handled would do harm.
    elif not _page.signal:
        _page.signal = number
        raise KeyboardInterrupt


class _Watcher:
    """The first process."""

    def __init__(self, child: int, page: _Page, record: WorkRecord) -> None:
        self._child, self._page, self._record = child, page, record
        self._number, self._last = 0, 0.0

    def watch(self) -> int:
        """Wait for the child, print how it ended, and remove what it has left; returns the exit code."""
        signal.signal(signal.SIGALRM, lambda number, frame: self._send(signal.SIGKILL))
        handle_signals(self._pass_on)
        _, status = os.waitpid(self._child, 0)
        # From here on it is as it is: what is left is removed, whatever comes.
        ignore_signals()
        signal.signal(signal.SIGALRM, signal.SIG_IGN)
        code = os.waitstatus_to_exitcode(status)
        # At the very end of a Python process, after its handlers, a signal ends it as by default.
        number = self._number or self._page.signal or (-code if -code in STOP_SIGNALS else 0)
        if code < 0:
            self._record.clear()
            self._print_end(-code, number)
        # Ctrl-C is how some work is meant to end.
        if number and (code or self._page.signal not in (0, signal.SIGINT)):
            return EXIT_SIGNAL + number
        return code if code >= 0 else EXIT_FAILED

    def _pass_on(self, number: int, frame: FrameType | None) -> None:
        now = time.monotonic()
        again = bool(self._number) and now - self._last > SAME_SIGNAL_SECONDS
        self._number, self._last = self._number or number, now
        if again or not self._page.ends_itself:
            self._send(signal.SIGKILL)
            return
        self._send(number)
        if not signal.getitimer(signal.ITIMER_REAL)[0]:
            signal.setitimer(signal.ITIMER_REAL, END_SECONDS)

    def _send(self, number: int) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(self._child, number)

    def _print_end(self, ended_by: int, number: int) -> None:
        if sys.stderr is not None and sys.stderr.isatty():
            sys.stderr.write(RESET_LINE)
        if number == signal.SIGINT:
            print_message("error", "interrupted")
        elif number:
            print_message("error", f"stopped by {signal.Signals(number).name}")
        else:
            print_message("error", _reason(ended_by, self._page.file, self._page.is_opening))


def _reason(number: int, file: str, is_opening: bool) -> str:
    """Why the work ended by a signal; ``file`` is the last that was opened, empty for none."""
    try:
        name = signal.Signals(number).name
    except ValueError:
        name = f"signal {number}"
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
