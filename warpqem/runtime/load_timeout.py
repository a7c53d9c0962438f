"""What keeps a damaged file from holding a process for ever, or from ending it without a word.

USD parses files in native code, which no exception interrupts. A process that somebody watches, such as a worker of a
batch or the command line's, limits the time for it and says which file it opens; how it ended is told by who watches.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = ["TIME_IS_UP", "load_timeout", "report_loading"]

# Processor time for opening a file: a crate file takes some milliseconds however large it is, text some seconds for 100
# MB. Time in which the disk or other work keeps it waiting does not count.
MIN_SECONDS, BYTES_A_SECOND = 8.0, 2**20

# The signal that ends a process whose time is up, by the name that a watcher sees; none on Windows.
TIME_IS_UP = "SIGPROF"

_told: Callable[[str, bool], None] | None = None


def report_loading(told: Callable[[str, bool], None]) -> None:
    """From now on limit the time for opening a file in this process, which ends it.

    Args:
        told: Called with each file and whether it is still to be opened, before and after.
    """
    global _told
    _told = told


@contextmanager
def load_timeout(file: str) -> Iterator[None]:
    """Open a file within: in a watched process, within its time."""
    if _told is None or not hasattr(signal, "setitimer"):
        yield
        return
    _told(file, True)
    # Of a file in a package the package counts; the name of any file may hold a bracket, too.
    path = Path(file if os.path.exists(file) else file.split("[", 1)[0])
    size = path.stat().st_size if path.is_file() else 0
    signal.setitimer(signal.ITIMER_PROF, MIN_SECONDS + size / BYTES_A_SECOND)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        _told(file, False)
