"""Processes that no later one is taken for, and the record of those that work for this one."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

__all__ = ["ProcessId", "note_process", "own_id", "record_processes"]

# Where /proc/PID/stat has the start after the name, whose parentheses end the part that is hard to split.
START_FIELD = 19

_record: Callable[[int], None] | None = None


@dataclass(frozen=True)
class ProcessId:
    """A process that no later one is taken for.

    Attributes:
        number: The process id.
        started: When it started, in clock ticks since the boot; 0 where the system does not say.
    """

    number: int
    started: int

    @classmethod
    def of(cls, number: int) -> ProcessId:
        """The process that has an id now."""
        fields = _status(number)
        return cls(number, int(fields[START_FIELD]) if fields else 0)

    def is_alive(self) -> bool:
        """Whether it is still at work; True where the system does not say."""
        if os.name != "posix":
            return True  # there is no asking without touching it
        try:
            os.kill(self.number, 0)
        except ProcessLookupError:
            return False
        except OSError:
            pass  # it is another user's
        fields = _status(self.number)
        if not fields:
            return True
        # One that has ended is still known until its parent, or what stands in for it, has asked how.
        return fields[0] not in ("Z", "X") and self.started in (0, int(fields[START_FIELD]))


def own_id() -> ProcessId:
    """This process."""
    return _own_id(os.getpid())


@functools.lru_cache(1)
def _own_id(number: int) -> ProcessId:
    return ProcessId.of(number)


def record_processes(record: Callable[[int], None]) -> None:
    """From now on call something with the process id of each worker of this process."""
    global _record
    _record = record


def note_process(number: int) -> None:
    """Record a worker of this process."""
    if _record is not None:
        _record(number)


def _status(process: int) -> list[str]:
    """State of a process and what comes after it; empty where the system does not say."""
    try:
        return Path(f"/proc/{process}/stat").read_text(errors="replace").rpartition(")")[2].split()
    except OSError:
        return []
