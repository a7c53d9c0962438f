"""Simplification of animated meshes with quadric error metrics over all frames, on NVIDIA Warp.

The core takes and gives arrays; :mod:`warpqem.usd` reads and writes stages; ``warpqem`` on the command line uses both.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    # What type checkers and editors read; a test holds it against the homes below.
    from warpqem.attributes import AttributeField as AttributeField
    from warpqem.batching.jobs import BatchJob as BatchJob
    from warpqem.batching.result import BatchResult as BatchResult
    from warpqem.batching.run import batch as batch
    from warpqem.cost_models import CostModelSpec as CostModelSpec
    from warpqem.cost_models import cost_model_names as cost_model_names
    from warpqem.face.features import FacialFeatures as FacialFeatures
    from warpqem.face.features import facial_features as facial_features
    from warpqem.face.protect import FaceProtection as FaceProtection
    from warpqem.face.retarget import FaceMesh as FaceMesh
    from warpqem.face.retarget import RetargetedMotion as RetargetedMotion
    from warpqem.face.retarget import retarget as retarget
    from warpqem.frame_stream import FrameSink as FrameSink
    from warpqem.frame_stream import FrameSource as FrameSource
    from warpqem.levels import LevelOrder as LevelOrder
    from warpqem.levels import order_levels as order_levels
    from warpqem.levels import simplify_levels as simplify_levels
    from warpqem.memory import MemoryPlan as MemoryPlan
    from warpqem.mesh_files.sequence import MeshSequence as MeshSequence
    from warpqem.mesh_files.sequence import load as load
    from warpqem.mirror import find_mirror as find_mirror
    from warpqem.morph import morph_weights as morph_weights
    from warpqem.motion import MotionFeatures as MotionFeatures
    from warpqem.motion import MotionWeighting as MotionWeighting
    from warpqem.motion import motion_features as motion_features
    from warpqem.progressive.build import build_progressive as build_progressive
    from warpqem.progressive.mesh import ProgressiveMesh as ProgressiveMesh
    from warpqem.result import SimplifiedMesh as SimplifiedMesh
    from warpqem.sharing import FrameShare as FrameShare
    from warpqem.sharing import help_place as help_place
    from warpqem.simplification import plan as plan
    from warpqem.simplification import simplify as simplify
    from warpqem.skinning.fit import FittedSkin as FittedSkin
    from warpqem.skinning.fit import fit_skin as fit_skin
    from warpqem.skinning.skin import LinearSkin as LinearSkin
    from warpqem.symmetry import simplify_symmetric as simplify_symmetric

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
    "find_mirror": "warpqem.mirror",
    "simplify_symmetric": "warpqem.symmetry",
    "simplify": "warpqem.simplification",
    "simplify_levels": "warpqem.levels",
}

__all__ = [*_HOMES, "__version__"]


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


def __dir__() -> list[str]:
    return sorted(__all__)
