"""Simplification of animated meshes with quadric error metrics over all frames, on NVIDIA Warp.

The core takes and gives arrays; :mod:`warpqem.usd` reads and writes stages; ``warpqem`` on the command line uses both.
"""

from __future__ import annotations

import importlib
from importlib.metadata import PackageNotFoundError, version
from typing import Any

try:
    __version__ = version("warpqem")
except PackageNotFoundError:  # a checkout on the path, not installed
    __version__ = "0+unknown"

# Loaded when first used: importing Warp takes most of a second, which `warpqem --help` need not wait for.
_HOMES = {
    "MotionFeatures": "warpqem.motion",
    "SimplifiedMesh": "warpqem.simplification",
    "motion_features": "warpqem.motion",
    "simplify": "warpqem.simplification",
}

__all__ = ["MotionFeatures", "SimplifiedMesh", "__version__", "motion_features", "simplify"]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'warpqem' has no attribute {name!r}")
