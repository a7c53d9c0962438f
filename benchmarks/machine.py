"""What the figures were measured on."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path
from typing import Any

__all__ = ["available_memory", "describe_host", "describe_machine"]

ROOT = Path(__file__).resolve().parent.parent


def describe_machine(packages: Iterable[str]) -> dict[str, Any]:
    """Hardware, load, versions of the packages and the commit, ready for JSON."""
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    gpus = [device.name for device in wp.get_cuda_devices()] if wp.is_cuda_available() else []
    return describe_host(packages) | {"gpus": gpus}


def describe_host(packages: Iterable[str]) -> dict[str, Any]:
    """The same without a look at GPUs, which are none in it: for where one may hang."""
    return {
        "cpu": _cpu_model(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "load": [round(x, 2) for x in os.getloadavg()],
        "gpus": [],
        "memory_gb": round(_memory("MemTotal") / 1e9, 1),
        "system": platform.platform(),
        "python": platform.python_version(),
        "commit": _commit(),
        "versions": {name: _version(name) for name in sorted({"numpy", "warp-lang", *packages})},
    }


def available_memory(device: str | None) -> int:
    """Bytes that may be taken on the host, or on the device where it is a GPU."""
    import warp as wp

    chosen = wp.get_device(device)
    return int(chosen.free_memory) if chosen.is_cuda else _memory("MemAvailable")


def _lines(path: str) -> list[str]:
    try:
        return Path(path).read_text(encoding="utf-8").splitlines()
    except OSError:
        return []


def _cpu_model() -> str:
    names = [line.split(":", 1)[1].strip() for line in _lines("/proc/cpuinfo") if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def _memory(field: str) -> int:
    """A line of /proc/meminfo in bytes; all of the memory where there is no such file."""
    for line in _lines("/proc/meminfo"):
        if line.startswith(f"{field}:"):
            return int(line.split()[1]) * 1024
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def _commit() -> str:
    """The checkout's commit, with a + where files differ from it; empty outside a checkout and without git."""
    if shutil.which("git") is None:
        return ""
    command = ["git", "-C", str(ROOT)]
    head = subprocess.run([*command, "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
    changed = subprocess.run([*command, "diff", "--quiet", "HEAD"], capture_output=True, check=False)
    return head.stdout.strip() + ("+" if changed.returncode == 1 else "") if head.returncode == 0 else ""


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        # warpqem itself may run from the checkout; the commit says which.
        return "not installed"
