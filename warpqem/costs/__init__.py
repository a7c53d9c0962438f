"""What a collapse costs: cost models, weights of vertices and frames, motion features, attributes.

Imports arguments, mesh, frames and runtime.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    # What type checkers and editors read; a test holds it against the homes below.
    from warpqem.costs.attributes import AttributeField as AttributeField
    from warpqem.costs.blend_shape_weights import morph_weights as morph_weights
    from warpqem.costs.models import CostModelSpec as CostModelSpec
    from warpqem.costs.models import cost_model_names as cost_model_names
    from warpqem.costs.motion_features import MotionWeighting as MotionWeighting

# Loaded when first used: the command line needs the names of the cost models, and not Warp.
_HOMES = {
    "AttributeField": "warpqem.costs.attributes",
    "CostModelSpec": "warpqem.costs.models",
    "MotionWeighting": "warpqem.costs.motion_features",
    "cost_model_names": "warpqem.costs.models",
    "morph_weights": "warpqem.costs.blend_shape_weights",
}

__all__ = [*_HOMES]


if not TYPE_CHECKING:  # to a type checker every name would exist

    def __getattr__(name: str) -> Any:
        if name in _HOMES:
            return getattr(importlib.import_module(_HOMES[name]), name)
        raise AttributeError(f"module 'warpqem.costs' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
