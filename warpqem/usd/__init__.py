"""Read animated meshes from USD, write simplified ones back.

The modules import pxr and, through the core, Warp; nothing of that happens before a name is first used.
"""

from __future__ import annotations

import importlib
from typing import Any

_HOMES = {
    "CompareOptions": "warpqem.usd.compare",
    "FrameRange": "warpqem.usd.frames",
    "SimplifyOptions": "warpqem.usd.simplify_options",
    "color_features": "warpqem.usd.features",
    "compare_stages": "warpqem.usd.compare",
    "inspect_stage": "warpqem.usd.inspect",
    "simplify_stage": "warpqem.usd.simplify",
}

__all__ = [
    "CompareOptions",
    "FrameRange",
    "SimplifyOptions",
    "color_features",
    "compare_stages",
    "inspect_stage",
    "simplify_stage",
]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'warpqem.usd' has no attribute {name!r}")
