"""Quality of a simplified mesh sequence against its reference: distances, motion, validity, heat map."""

from warpqem.measure.comparison import Comparison, FrameErrors, compare
from warpqem.measure.heatmap import distance_colors, vertex_distances
from warpqem.measure.measured import Measured
from warpqem.measure.topology import Topology, topology
from warpqem.measure.verdict import LIMITS, Verdict

__all__ = [
    "LIMITS",
    "Comparison",
    "FrameErrors",
    "Measured",
    "Topology",
    "Verdict",
    "compare",
    "distance_colors",
    "topology",
    "vertex_distances",
]
