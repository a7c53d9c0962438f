"""Simplification of animated meshes with quadric error metrics over all frames, on NVIDIA Warp.

The core takes and gives arrays; :mod:`warpqem.usd` reads and writes stages; ``warpqem`` on the command line uses both.
What simplifying everywhere needs is here. The rest has rooms: :mod:`warpqem.costs`, :mod:`warpqem.errors`,
:mod:`warpqem.face`, :mod:`warpqem.measure`, :mod:`warpqem.picture`, :mod:`warpqem.progressive`, :mod:`warpqem.report`,
:mod:`warpqem.skinning`.
"""

from __future__ import annotations

import importlib
import warnings
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    # What type checkers and editors read; a test holds it against the homes below.
    from warpqem import costs as costs
    from warpqem import errors as errors
    from warpqem import face as face
    from warpqem import measure as measure
    from warpqem import picture as picture
    from warpqem import progressive as progressive
    from warpqem import report as report
    from warpqem import skinning as skinning
    from warpqem import usd as usd
    from warpqem.batching.job_result import BatchResult as BatchResult
    from warpqem.batching.jobs import BatchJob as BatchJob
    from warpqem.batching.run_batch import batch as batch
    from warpqem.costs.motion_features import MotionFeatures as MotionFeatures
    from warpqem.costs.motion_features import motion_features as motion_features
    from warpqem.frames.stream import FrameSink as FrameSink
    from warpqem.frames.stream import FrameSource as FrameSource
    from warpqem.mesh_files.sequence import MeshSequence as MeshSequence
    from warpqem.mesh_files.sequence import load as load
    from warpqem.pipeline.levels import LevelOrder as LevelOrder
    from warpqem.pipeline.levels import order_levels as order_levels
    from warpqem.pipeline.levels import simplify_levels as simplify_levels
    from warpqem.pipeline.many import simplify_many as simplify_many
    from warpqem.pipeline.memory_plan import MemoryPlan as MemoryPlan
    from warpqem.pipeline.mirror import find_mirror as find_mirror
    from warpqem.pipeline.result import SimplifiedMesh as SimplifiedMesh
    from warpqem.pipeline.simplify import plan as plan
    from warpqem.pipeline.simplify import simplify as simplify
    from warpqem.pipeline.symmetry import simplify_symmetric as simplify_symmetric
    from warpqem.progressive.build import build_progressive as build_progressive
    from warpqem.progressive.progressive_mesh import ProgressiveMesh as ProgressiveMesh

    __version__: str

# Loaded when first used: importing Warp takes most of a second, which `warpqem --help` need not wait for.
_HOMES = {
    "BatchJob": "warpqem.batching.jobs",
    "BatchResult": "warpqem.batching.job_result",
    "FrameSink": "warpqem.frames.stream",
    "FrameSource": "warpqem.frames.stream",
    "LevelOrder": "warpqem.pipeline.levels",
    "MemoryPlan": "warpqem.pipeline.memory_plan",
    "MeshSequence": "warpqem.mesh_files.sequence",
    "MotionFeatures": "warpqem.costs.motion_features",
    "ProgressiveMesh": "warpqem.progressive.progressive_mesh",
    "SimplifiedMesh": "warpqem.pipeline.result",
    "batch": "warpqem.batching.run_batch",
    "build_progressive": "warpqem.progressive.build",
    "find_mirror": "warpqem.pipeline.mirror",
    "load": "warpqem.mesh_files.sequence",
    "motion_features": "warpqem.costs.motion_features",
    "order_levels": "warpqem.pipeline.levels",
    "plan": "warpqem.pipeline.simplify",
    "simplify": "warpqem.pipeline.simplify",
    "simplify_levels": "warpqem.pipeline.levels",
    "simplify_many": "warpqem.pipeline.many",
    "simplify_symmetric": "warpqem.pipeline.symmetry",
}

# Names of an earlier version, and what became of them.
_REMOVED = dict.fromkeys(
    ("FrameShare", "help_place"),
    "it was removed: one process places all frames of a mesh, and `warpqem batch` does several assets at once",
)

# Rooms whose `__all__` is public too.
_ROOMS = ("costs", "errors", "face", "measure", "picture", "progressive", "report", "skinning", "usd")

# Names that were here before 0.2 and the rooms that have them; gone in 0.3.
_MOVED = {
    "AttributeField": "warpqem.costs",
    "CostModelSpec": "warpqem.costs",
    "FaceMesh": "warpqem.face",
    "FaceProtection": "warpqem.face",
    "FacialFeatures": "warpqem.face",
    "FittedSkin": "warpqem.skinning",
    "LinearSkin": "warpqem.skinning",
    "MotionWeighting": "warpqem.costs",
    "RetargetedMotion": "warpqem.face",
    "cost_model_names": "warpqem.costs",
    "facial_features": "warpqem.face",
    "fit_skin": "warpqem.skinning",
    "morph_weights": "warpqem.costs",
    "retarget": "warpqem.face",
}

# Without the rooms: a star import is to load no USD.
__all__ = [*_HOMES, "__version__"]


def _version() -> str:
    # The package metadata reader takes as long to load as NumPy.
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("warpqem")
    except PackageNotFoundError:  # a checkout on the path, not installed
        return "0+unknown"


if not TYPE_CHECKING:  # to a type checker every name would exist

    def __getattr__(name: str) -> Any:
        if name == "__version__":
            return _version()
        if name in _HOMES:
            return getattr(importlib.import_module(_HOMES[name]), name)
        if name in _ROOMS:
            return importlib.import_module(f"warpqem.{name}")
        if name in _MOVED:
            home = _MOVED[name]
            warnings.warn(f"warpqem.{name} is now {home}.{name}", DeprecationWarning, stacklevel=2)
            return getattr(importlib.import_module(home), name)
        why = f" ({_REMOVED[name]})" if name in _REMOVED else ""
        raise AttributeError(f"module 'warpqem' has no attribute {name!r}{why}")


def __dir__() -> list[str]:
    return sorted([*__all__, *_ROOMS])
