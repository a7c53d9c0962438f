"""Memory in words such as "8G", and how much of it is free."""

from __future__ import annotations

import functools
import math
import os
import re
import time
from pathlib import Path

import warp as wp

from warpqem.errors import OptionError
from warpqem.runtime.device import resolve_device

__all__ = ["DEFAULT_SHARE", "available_memory", "default_limit", "format_bytes", "parse_bytes"]

UNITS = {"": 1, "K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40}
# Without a limit this part of what is free is used: other programs need some, and the factors are not exact.
DEFAULT_SHARE = 0.8
# Seconds for which the system is not asked again what is free: that takes a hundredth of a small mesh's time, and a
# call asks four times.
READ_AGAIN = 0.1


def parse_bytes(value: int | str) -> int:
    """Bytes from a number or text such as "8G", "500M" or "1.5 GiB" (powers of 1024).

    Raises:
        OptionError: it is no positive number of bytes.
    """
    found = re.fullmatch(r"\s*\+?(\d+(?:\.\d+)?)\s*([KMGT]?)(?:i?B)?\s*", str(value), re.ASCII | re.IGNORECASE)
    size = float(found[1]) * UNITS[found[2].upper()] if found else 0.0
    count = int(size) if math.isfinite(size) else 0
    if count < 1:
        raise OptionError(f"memory {value!r}: expected bytes above 0, such as 8G or 500M")
    return count


def format_bytes(count: int) -> str:
    """Bytes with a suffix, rounded up so that what is printed is enough when given back."""
    for suffix, size in (("G", 2**30), ("M", 2**20)):
        if count >= size:
            tenths = -(-10 * count // size)
            return f"{tenths / 10:.1f}{suffix}" if tenths < 100 else f"{-(-count // size)}{suffix}"
    return f"{-(-count // 2**10)}K"


def available_memory(device: str) -> int | None:
    """Bytes that are free on the host, and on the device if it is another; None where the system does not say.

    Those of the host are as they were up to ``READ_AGAIN`` seconds ago.
    """
    found = list(_host_free(int(time.monotonic() / READ_AGAIN)))
    used = wp.get_device(resolve_device(device))
    if used.is_cuda:
        found.append(int(used.free_memory))
    return min(found, default=None)


@functools.lru_cache(maxsize=1)
def _host_free(moment: int) -> tuple[int, ...]:
    """What the system and the container say that is free at a moment, which small meshes share."""
    return tuple(free for free in (_system_free(), _group_free()) if free is not None)


def default_limit(device: str) -> int | None:
    """Bytes that may be used where nobody says how many; None where the system does not say what is free."""
    free = available_memory(device)
    return None if free is None else int(DEFAULT_SHARE * free)


def _system_free() -> int | None:
    try:
        found = re.search(r"^MemAvailable:\s+(\d+) kB", Path("/proc/meminfo").read_text(encoding="ascii"), re.MULTILINE)
    except OSError:
        found = None
    if found:
        return 1024 * int(found[1])
    names = getattr(os, "sysconf_names", {})
    if "SC_PHYS_PAGES" in names:
        # Free memory is unknown, as on macOS: half of all.
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2
    return None


def _group_free() -> int | None:
    """What a container may still take (cgroup v2)."""
    group = Path("/sys/fs/cgroup")
    try:
        return int((group / "memory.max").read_text()) - int((group / "memory.current").read_text())
    except (OSError, ValueError):
        return None
