"""Limits of the process (ulimit), and which of them an error comes from: a file is not to blame for them."""

from __future__ import annotations

import errno
import re
from collections.abc import Iterator
from dataclasses import dataclass

from warpqem.errors import ProcessLimitError, WarpqemError

__all__ = ["check_limits", "limit_behind_error", "limit_behind_signal", "with_limit"]


@dataclass(frozen=True)
class _Limit:
    """A limit that systems set for a process.

    Attributes:
        resource: Name in the module resource, without RLIMIT_.
        what: What is limited.
        flag: Of the shell's ulimit.
        unit: Of the limit; empty for a count.
        enough: From here on it is no reason for a crash; None for no such size.
        least: Below it nothing can be done; 0 for no such size.
    """

    resource: str
    what: str
    flag: str
    unit: str = "bytes"
    enough: int | None = None
    least: int = 0


# Python, USD and Warp map 1.5 GiB of address space before they do anything, most of it their own code, and each thread
# maps some more. Stacks are of 8 MiB on Linux; 256 KiB end in a crash when the first thread starts. A process without a
# file has 3 open, the watcher of the command line 2 more, and USD needs one.
ADDRESSES = _Limit("AS", "address space", "-v", enough=16 * 2**30, least=512 * 2**20)
DATA = _Limit("DATA", "memory", "-d", enough=16 * 2**30, least=128 * 2**20)
STACK = _Limit("STACK", "stack", "-s", enough=8 * 2**20, least=320 * 2**10)
FILES = _Limit("NOFILE", "open files", "-n", unit="", least=8)
FILE_SIZE = _Limit("FSIZE", "the size of a file", "-f")
PROCESSOR = _Limit("CPU", "processor time", "-t", unit="s")
PROCESSES = _Limit("NPROC", "processes and threads", "-u", unit="")

MEMORY = (ADDRESSES, DATA)
BY_NUMBER = {
    errno.ENOMEM: MEMORY,
    errno.EMFILE: (FILES,),
    errno.EFBIG: (FILE_SIZE,),
    errno.EAGAIN: (PROCESSES, *MEMORY),
}
# What libraries say in errors of other kinds.
BY_TEXT = (
    (re.compile(r"too many open files", re.IGNORECASE), (FILES,)),
    (re.compile(r"file too large|no usable temporary directory", re.IGNORECASE), (FILE_SIZE,)),
    (re.compile(r"can't start new thread|resource temporarily unavailable", re.IGNORECASE), (PROCESSES, *MEMORY)),
    (
        re.compile(
            r"out of memory|cannot allocate memory|bad_?alloc|failed to map segment|failed to load the shared library",
            re.IGNORECASE,
        ),
        MEMORY,
    ),
)
BY_SIGNAL = {
    "SIGXFSZ": (FILE_SIZE,),
    "SIGXCPU": (PROCESSOR,),
    "SIGKILL": (PROCESSOR,),
    "SIGSEGV": (STACK, *MEMORY),
    "SIGBUS": (STACK, *MEMORY),
    "SIGABRT": (*MEMORY, STACK),
}


def limit_behind_error(error: BaseException) -> str:
    """Which limit of this process an error comes from, such as "open files are limited to 20 (ulimit -n)".

    Returns:
        Empty if it comes from none.
    """
    for one in _chain(error):
        if isinstance(one, MemoryError) and not isinstance(one, WarpqemError):
            return _told(MEMORY)
        if isinstance(one, OSError) and one.errno in BY_NUMBER:
            return _told(BY_NUMBER[one.errno])
        for pattern, limits in BY_TEXT:
            if pattern.search(str(one)):
                return _told(limits)
    return ""


def with_limit(text: str, error: BaseException) -> str:
    """The text of an error, and the limit of this process that it comes from."""
    limit = limit_behind_error(error)
    return f"{text}; {limit}" if limit else text


def limit_behind_signal(name: str) -> str:
    """Which limit of this process, and so of those it has started, one may have been ended by a signal for.

    Returns:
        Empty if all limits are as wide as is usual.
    """
    return _told(BY_SIGNAL.get(name, ()), only_small=True)


def check_limits() -> None:
    """Refuse to start below what Python, USD and Warp need to be loaded; they would end without a word.

    Raises:
        ProcessLimitError: a limit is too small.
    """
    for limit in (ADDRESSES, DATA, STACK, FILES):
        value = _value(limit)
        if value is not None and value < limit.least:
            raise ProcessLimitError(
                f"{_text(limit, value)}; nothing can be done with less than {_size(limit, limit.least)}"
            )


def _chain(error: BaseException) -> Iterator[BaseException]:
    seen: set[int] = set()
    one: BaseException | None = error
    while one is not None and id(one) not in seen:
        seen.add(id(one))
        yield one
        one = one.__cause__ or one.__context__


def _told(limits: tuple[_Limit, ...], only_small: bool = False) -> str:
    found = []
    for limit in limits:
        value = _value(limit)
        if value is not None and not (only_small and limit.enough is not None and value >= limit.enough):
            found.append(_text(limit, value))
    return " and ".join(found)


def _value(limit: _Limit) -> int | None:
    """The limit of this process; None for none."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    number = getattr(resource, f"RLIMIT_{limit.resource}", None)
    if number is None:
        return None
    soft, hard = resource.getrlimit(number)
    # The soft limit on data is that of --memory, too.
    value = hard if limit is DATA else soft
    return None if value == resource.RLIM_INFINITY else int(value)


def _text(limit: _Limit, value: int) -> str:
    verb = "are" if limit in (FILES, PROCESSES) else "is"
    return f"{limit.what} {verb} limited to {_size(limit, value)} for this process (ulimit {limit.flag})"


def _size(limit: _Limit, value: int) -> str:
    if limit.unit != "bytes":
        return f"{value} {limit.unit}".rstrip()
    for suffix, size in (("G", 2**30), ("M", 2**20), ("K", 2**10)):
        if value >= size:
            return f"{value / size:.4g}{suffix}"
    return f"{value} bytes"
