"""Quality of a simplified mesh sequence against its reference: distances, motion, appearance, validity, heat map."""

from warpqem.measure.appearance import (
    Appearance,
    CornerValues,
    SampledErrors,
    SurfaceValues,
    UvErrors,
    compare_appearance,
)
from warpqem.measure.comparison import Comparison, FrameErrors, compare
from warpqem.measure.heatmap import distance_colors, vertex_distances
from warpqem.measure.measured import Measured
from warpqem.measure.validity import Topology, topology
from warpqem.measure.verdict import LIMITS, Verdict

__all__ = [
    "LIMITS",
    "Appearance",
    "Comparison",
    "CornerValues",
    "FrameErrors",
    "Measured",
    "SampledErrors",
    "SurfaceValues",
    "Topology",
    "UvErrors",
    "Verdict",
    "compare",
    "compare_appearance",
    "distance_colors",
    "topology",
    "vertex_distances",
]
