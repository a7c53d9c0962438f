"""How much memory this process takes, has taken, and may take."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = ["limit_memory", "limited_memory", "peak_memory", "reset_peak"]

STATUS = Path("/proc/self/status")
# Room above what is planned: the plan's factors are not exact, and a file is read before there is a plan.
SLACK_SHARE, SLACK_BYTES = 1.25, 256 * 2**20


def peak_memory() -> int | None:
    """The most bytes of memory that this process has had at one time; None where the system does not say."""
    peak = _status("VmHWM")
    if peak is not None:
        return peak
    try:
        import resource
    except ImportError:  # Windows
        return None
    # Bytes, as on macOS; Linux, which counts in KiB, was served above.
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def reset_peak() -> None:
    """Let `peak_memory` begin anew; where the system cannot, it goes on from the start of the process."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return


def limit_memory(more: int | None) -> None:
    """Refuse this process more memory than it has now and some; what asks for more gets a MemoryError.

    Args:
        more: Bytes to be had on top of what the process has; a quarter and 256 MiB are added. None takes a limit back.
    """
    data = _status("VmData")
    if data is None:  # no Linux: the limit below does not count what is mapped there
        return
    import resource

    hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
    soft = hard if more is None else data + int(SLACK_SHARE * more) + SLACK_BYTES
    if hard != resource.RLIM_INFINITY:
        soft = min(soft, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


@contextmanager
def limited_memory(more: int | None) -> Iterator[None]:
    """`limit_memory` for a while; None for no limit."""
    if more is not None:
        limit_memory(more)
    try:
        yield
    finally:
        if more is not None:
            limit_memory(None)


def _status(name: str) -> int | None:
    try:
        found = re.search(rf"^{name}:\s+(\d+) kB", STATUS.read_text(encoding="ascii"), re.MULTILINE)
    except OSError:
        return None
    return 1024 * int(found[1]) if found else None
