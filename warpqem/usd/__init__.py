"""Read animated meshes from USD, write simplified ones back.

The modules import pxr and, through the core, Warp; nothing of that happens before a name is first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    # What type checkers and editors read; a test holds it against the homes below.
    from warpqem.usd.commands.compare import CompareOptions as CompareOptions
    from warpqem.usd.commands.compare import compare_stages as compare_stages
    from warpqem.usd.commands.compare_images import compare_stage_images as compare_stage_images
    from warpqem.usd.commands.motion_features import color_features as color_features
    from warpqem.usd.commands.simplify import simplify_stage as simplify_stage
    from warpqem.usd.commands.simplify_options import SimplifyOptions as SimplifyOptions
    from warpqem.usd.read.inspect import inspect_stage as inspect_stage
    from warpqem.usd.read.time_codes import FrameRange as FrameRange

_HOMES = {
    "CompareOptions": "warpqem.usd.commands.compare",
    "FrameRange": "warpqem.usd.read.time_codes",
    "SimplifyOptions": "warpqem.usd.commands.simplify_options",
    "color_features": "warpqem.usd.commands.motion_features",
    "compare_stage_images": "warpqem.usd.commands.compare_images",
    "compare_stages": "warpqem.usd.commands.compare",
    "inspect_stage": "warpqem.usd.read.inspect",
    "simplify_stage": "warpqem.usd.commands.simplify",
}

__all__ = [*_HOMES]


# Options can be made where no USD is, such as a machine that sends jobs to a cluster.
_WITHOUT_USD = {"FrameRange", "SimplifyOptions"}


if not TYPE_CHECKING:  # to a type checker every name would exist

    def __getattr__(name: str) -> Any:
        if name in _HOMES:
            if name not in _WITHOUT_USD:
                importlib.import_module("warpqem.usd.checks.library").need_usd()
            return getattr(importlib.import_module(_HOMES[name]), name)
        raise AttributeError(f"module 'warpqem.usd' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
