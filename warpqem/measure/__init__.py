"""Quality of a simplified mesh sequence against its reference: distances, motion, appearance, validity, heat map.

A module is loaded when one of its names is first used: simplifying measures distances alone.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    # What type checkers and editors read.
    from warpqem.measure.appearance import Appearance as Appearance
    from warpqem.measure.appearance import CornerValues as CornerValues
    from warpqem.measure.appearance import SampledErrors as SampledErrors
    from warpqem.measure.appearance import SurfaceValues as SurfaceValues
    from warpqem.measure.appearance import UvErrors as UvErrors
    from warpqem.measure.appearance import compare_appearance as compare_appearance
    from warpqem.measure.comparison import Comparison as Comparison
    from warpqem.measure.comparison import FrameErrors as FrameErrors
    from warpqem.measure.comparison import compare as compare
    from warpqem.measure.heatmap import distance_colors as distance_colors
    from warpqem.measure.heatmap import vertex_distances as vertex_distances
    from warpqem.measure.measured import Measured as Measured
    from warpqem.measure.validity import Topology as Topology
    from warpqem.measure.validity import topology as topology
    from warpqem.measure.verdict import LIMITS as LIMITS
    from warpqem.measure.verdict import Verdict as Verdict

_HOMES = {
    "Appearance": "warpqem.measure.appearance",
    "Comparison": "warpqem.measure.comparison",
    "CornerValues": "warpqem.measure.appearance",
    "FrameErrors": "warpqem.measure.comparison",
    "LIMITS": "warpqem.measure.verdict",
    "Measured": "warpqem.measure.measured",
    "SampledErrors": "warpqem.measure.appearance",
    "SurfaceValues": "warpqem.measure.appearance",
    "Topology": "warpqem.measure.validity",
    "UvErrors": "warpqem.measure.appearance",
    "Verdict": "warpqem.measure.verdict",
    "compare": "warpqem.measure.comparison",
    "compare_appearance": "warpqem.measure.appearance",
    "distance_colors": "warpqem.measure.heatmap",
    "topology": "warpqem.measure.validity",
    "vertex_distances": "warpqem.measure.heatmap",
}

__all__ = [*_HOMES]


if not TYPE_CHECKING:  # to a type checker every name would exist

    def __getattr__(name: str) -> Any:
        if name in _HOMES:
            return getattr(importlib.import_module(_HOMES[name]), name)
        raise AttributeError(f"module 'warpqem.measure' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
