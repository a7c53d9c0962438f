"""One part in a process of its own: ``python -m benchmarks.device.child PART SETTINGS FILE``."""

from __future__ import annotations

import importlib
import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.device.findings import Findings
from benchmarks.device.parts import PARTS
from benchmarks.settings import Settings

__all__ = ["from_json", "main", "to_json"]

PATHS = ("out", "usd", "data", "pack")


def to_json(settings: Settings) -> str:
    """The settings as an argument of the process."""
    return json.dumps({name: str(v) if isinstance(v, Path) else v for name, v in asdict(settings).items()})


def from_json(text: str) -> Settings:
    """What :func:`to_json` wrote."""
    given: dict[str, Any] = json.loads(text)
    for name in PATHS:
        given[name] = None if given[name] is None else Path(given[name])
    return Settings(**given | {"parts": tuple(given["parts"])})


def main(part_name: str, settings: str, file: str) -> None:
    """Run one part."""
    import warp as wp

    from warpqem.device import resolve_device

    wp.config.log_level = wp.LOG_WARNING
    part = next(part for part in PARTS if part.name == part_name)
    given = from_json(settings)
    module, function = part.function.split(":")
    run = getattr(importlib.import_module(f"benchmarks.device.{module}"), function)
    run(Findings(part_name, given, resolve_device(given.device), Path(file)))


if __name__ == "__main__":
    main(*sys.argv[1:])
