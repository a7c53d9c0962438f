"""With what a report was made."""

from __future__ import annotations

import math
import os
import platform
from dataclasses import asdict, fields
from typing import Any

import numpy as np
import warp as wp
from pxr import Usd

import warpqem
from warpqem.costs.models import cost_model
from warpqem.runtime.device import resolve_device
from warpqem.runtime.process_memory import peak_memory
from warpqem.usd.commands.simplify_options import SimplifyOptions

__all__ = ["run_info"]


def run_info(options: SimplifyOptions, seconds: float) -> dict[str, Any]:
    """Versions, machine, device, options, wall-clock seconds and peak memory in bytes, ready for JSON."""
    device = wp.get_device(resolve_device(options.device))
    # A cost model may hold a function, which has no copy and no text.
    given = {entry.name: getattr(options, entry.name) for entry in fields(options)}
    given["metric"] = cost_model(options.metric).name
    given["screen"] = None if options.screen is None else asdict(options.screen)
    given |= {name: None if given[name] is None else os.fspath(given[name]) for name in ("poses", "face_points")}
    # JSON has no infinity: it stands as the text that the option is given with.
    given |= {name: str(value) for name, value in given.items() if isinstance(value, float) and math.isinf(value)}
    return {
        "versions": {
            "warpqem": warpqem.__version__,
            "warp": wp.__version__,
            "usd": ".".join(map(str, Usd.GetVersion())),
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
        "platform": platform.platform(),
        "device": device.alias,
        "device_name": device.name,
        "options": given,
        "seconds": seconds,
        "peak_memory": peak_memory(),
    }
