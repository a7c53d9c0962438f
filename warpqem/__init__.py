"""Simplification of animated meshes with quadric error metrics over all frames, on NVIDIA Warp.

The core takes and gives arrays; :mod:`warpqem.usd` reads and writes stages; ``warpqem`` on the command line uses both.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    # What type checkers and editors read; a test holds it against the homes below.
    from warpqem.batching.job_result import BatchResult as BatchResult
    from warpqem.batching.jobs import BatchJob as BatchJob
    from warpqem.batching.run_batch import batch as batch
    from warpqem.costs.attributes import AttributeField as AttributeField
    from warpqem.costs.blend_shape_weights import morph_weights as morph_weights
    from warpqem.costs.models import CostModelSpec as CostModelSpec
    from warpqem.costs.models import cost_model_names as cost_model_names
    from warpqem.costs.motion_features import MotionFeatures as MotionFeatures
    from warpqem.costs.motion_features import MotionWeighting as MotionWeighting
    from warpqem.costs.motion_features import motion_features as motion_features
    from warpqem.face.feature_points import FacialFeatures as FacialFeatures
    from warpqem.face.feature_points import facial_features as facial_features
    from warpqem.face.protect import FaceProtection as FaceProtection
    from warpqem.face.retarget import FaceMesh as FaceMesh
    from warpqem.face.retarget import RetargetedMotion as RetargetedMotion
    from warpqem.face.retarget import retarget as retarget
    from warpqem.frames.stream import FrameSink as FrameSink
    from warpqem.frames.stream import FrameSource as FrameSource
    from warpqem.mesh_files.sequence import MeshSequence as MeshSequence
    from warpqem.mesh_files.sequence import load as load
    from warpqem.pipeline.levels import LevelOrder as LevelOrder
    from warpqem.pipeline.levels import order_levels as order_levels
    from warpqem.pipeline.levels import simplify_levels as simplify_levels
    from warpqem.pipeline.memory_plan import MemoryPlan as MemoryPlan
    from warpqem.pipeline.mirror import find_mirror as find_mirror
    from warpqem.pipeline.result import SimplifiedMesh as SimplifiedMesh
    from warpqem.pipeline.simplify import plan as plan
    from warpqem.pipeline.simplify import simplify as simplify
    from warpqem.pipeline.symmetry import simplify_symmetric as simplify_symmetric
    from warpqem.progressive.build import build_progressive as build_progressive
    from warpqem.progressive.progressive_mesh import ProgressiveMesh as ProgressiveMesh
    from warpqem.skinning.fit_skin import FittedSkin as FittedSkin
    from warpqem.skinning.fit_skin import fit_skin as fit_skin
    from warpqem.skinning.linear_skin import LinearSkin as LinearSkin

# Loaded when first used: importing Warp takes most of a second, which `warpqem --help` need not wait for.
_HOMES = {
    "BatchJob": "warpqem.batching.jobs",
    "BatchResult": "warpqem.batching.job_result",
    "AttributeField": "warpqem.costs.attributes",
    "CostModelSpec": "warpqem.cost_models",
    "FaceMesh": "warpqem.face.retarget",
    "FaceProtection": "warpqem.face.protect",
    "FacialFeatures": "warpqem.face.feature_points",
    "FittedSkin": "warpqem.skinning.fit_skin",
    "FrameSink": "warpqem.frames.stream",
    "FrameSource": "warpqem.frames.stream",
    "LinearSkin": "warpqem.skinning.linear_skin",
    "MemoryPlan": "warpqem.pipeline.memory_plan",
    "MotionFeatures": "warpqem.costs.motion_features",
    "MotionWeighting": "warpqem.costs.motion_features",
    "RetargetedMotion": "warpqem.face.retarget",
    "retarget": "warpqem.face.retarget",
    "MeshSequence": "warpqem.mesh_files.sequence",
    "load": "warpqem.mesh_files.sequence",
    "ProgressiveMesh": "warpqem.progressive.progressive_mesh",
    "SimplifiedMesh": "warpqem.pipeline.result",
    "batch": "warpqem.batching.run_batch",
    "build_progressive": "warpqem.progressive.build",
    "cost_model_names": "warpqem.cost_models",
    "LevelOrder": "warpqem.pipeline.levels",
    "order_levels": "warpqem.pipeline.levels",
    "facial_features": "warpqem.face.feature_points",
    "fit_skin": "warpqem.skinning.fit_skin",
    "morph_weights": "warpqem.costs.blend_shape_weights",
    "motion_features": "warpqem.costs.motion_features",
    "plan": "warpqem.pipeline.simplify",
    "find_mirror": "warpqem.pipeline.mirror",
    "simplify_symmetric": "warpqem.pipeline.symmetry",
    "simplify": "warpqem.pipeline.simplify",
    "simplify_levels": "warpqem.pipeline.levels",
}

# Names of an earlier version, and what became of them.
_REMOVED = dict.fromkeys(
    ("FrameShare", "help_place"),
    "it was removed: one process places all frames of a mesh, and `warpqem batch` does several assets at once",
)

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
    why = f" ({_REMOVED[name]})" if name in _REMOVED else ""
    raise AttributeError(f"module 'warpqem' has no attribute {name!r}{why}")


def __dir__() -> list[str]:
    return sorted(__all__)
