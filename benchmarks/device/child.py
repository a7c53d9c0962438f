"""One part in a process of its own: ``python -m benchmarks.device.child PART SETTINGS FILE``."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

from benchmarks.device.findings import Findings
from benchmarks.device.parts import NO_GPU, PARTS
from benchmarks.settings import Settings

__all__ = ["main"]


def main(part_name: str, settings: str, file: str) -> None:
    """Run one part."""
    import warp as wp

    from warpqem.runtime.device import resolve_device

    wp.config.log_level = wp.LOG_WARNING
    part = next(part for part in PARTS if part.name == part_name)
    given = Settings.from_json(settings)
    device = resolve_device(given.device)
    if given.device is None and wp.get_device(device).is_cpu:
        sys.exit(NO_GPU)
    module, function = part.function.split(":")
    run = getattr(importlib.import_module(f"benchmarks.device.{module}"), function)
    run(Findings(part_name, given, device, Path(file)))


if __name__ == "__main__":
    main(*sys.argv[1:])
