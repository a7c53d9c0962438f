"""Simplification of animated meshes with quadric error metrics over all frames, on NVIDIA Warp.

The core takes and gives arrays; :mod:`warpqem.usd` reads and writes stages; ``warpqem`` on the command line uses both.
"""

from __future__ import annotations

import importlib
from typing import Any

# Loaded when first used: importing Warp takes most of a second, which `warpqem --help` need not wait for.
_HOMES = {
    "BatchJob": "warpqem.batching.jobs",
    "BatchResult": "warpqem.batching.result",
    "AttributeField": "warpqem.attributes",
    "CostModelSpec": "warpqem.cost_models",
    "FaceMesh": "warpqem.face.retarget",
    "FaceProtection": "warpqem.face.protect",
    "FacialFeatures": "warpqem.face.features",
    "FittedSkin": "warpqem.skinning.fit",
    "FrameShare": "warpqem.sharing",
    "FrameSink": "warpqem.frame_stream",
    "FrameSource": "warpqem.frame_stream",
    "LinearSkin": "warpqem.skinning.skin",
    "MemoryPlan": "warpqem.memory",
    "MotionFeatures": "warpqem.motion",
    "MotionWeighting": "warpqem.motion",
    "RetargetedMotion": "warpqem.face.retarget",
    "retarget": "warpqem.face.retarget",
    "MeshSequence": "warpqem.mesh_files.sequence",
    "load": "warpqem.mesh_files.sequence",
    "ProgressiveMesh": "warpqem.progressive.mesh",
    "SimplifiedMesh": "warpqem.result",
    "batch": "warpqem.batching.run",
    "build_progressive": "warpqem.progressive.build",
    "cost_model_names": "warpqem.cost_models",
    "LevelOrder": "warpqem.levels",
    "order_levels": "warpqem.levels",
    "facial_features": "warpqem.face.features",
    "fit_skin": "warpqem.skinning.fit",
    "morph_weights": "warpqem.morph",
    "motion_features": "warpqem.motion",
    "plan": "warpqem.simplification",
    "help_place": "warpqem.sharing",
    "find_mirror": "warpqem.symmetry",
    "simplify_symmetric": "warpqem.symmetry",
    "simplify": "warpqem.simplification",
    "simplify_levels": "warpqem.levels",
}

__all__ = [
    "AttributeField",
    "BatchJob",
    "BatchResult",
    "CostModelSpec",
    "FaceMesh",
    "FaceProtection",
    "FacialFeatures",
    "FittedSkin",
    "FrameShare",
    "FrameSink",
    "FrameSource",
    "LevelOrder",
    "LinearSkin",
    "MemoryPlan",
    "MeshSequence",
    "MotionFeatures",
    "MotionWeighting",
    "ProgressiveMesh",
    "RetargetedMotion",
    "SimplifiedMesh",
    "__version__",
    "batch",
    "build_progressive",
    "cost_model_names",
    "facial_features",
    "find_mirror",
    "fit_skin",
    "help_place",
    "load",
    "morph_weights",
    "motion_features",
    "order_levels",
    "plan",
    "retarget",
    "simplify",
    "simplify_levels",
    "simplify_symmetric",
]


def _version() -> str:
    # The package metadata reader takes as long to load as NumPy.
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("warpqem")
    except PackageNotFoundError:  # a checkout on the path, not installed
        return "0+unknown"


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return _version()
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'warpqem' has no attribute {name!r}")
