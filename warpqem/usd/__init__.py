"""Read animated meshes from USD, write simplified ones back.

The modules import pxr and, through the core, Warp; nothing of that happens before a name is first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    # What type checkers and editors read; a test holds it against the homes below.
    from warpqem.usd.compare import CompareOptions as CompareOptions
    from warpqem.usd.compare import compare_stages as compare_stages
    from warpqem.usd.features import color_features as color_features
    from warpqem.usd.frames import FrameRange as FrameRange
    from warpqem.usd.inspect import inspect_stage as inspect_stage
    from warpqem.usd.simplify import simplify_stage as simplify_stage
    from warpqem.usd.simplify_options import SimplifyOptions as SimplifyOptions

_HOMES = {
    "CompareOptions": "warpqem.usd.compare",
    "FrameRange": "warpqem.usd.frames",
    "SimplifyOptions": "warpqem.usd.simplify_options",
    "color_features": "warpqem.usd.features",
    "compare_stages": "warpqem.usd.compare",
    "inspect_stage": "warpqem.usd.inspect",
    "simplify_stage": "warpqem.usd.simplify",
}

__all__ = [*_HOMES]


# Options can be made where no USD is, such as a machine that sends jobs to a cluster.
_WITHOUT_USD = {"FrameRange", "SimplifyOptions"}


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        if name not in _WITHOUT_USD:
            importlib.import_module("warpqem.usd.library").need_usd()
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'warpqem.usd' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
