"""Quality of a simplified mesh sequence against its reference: distances, motion, validity, heat map."""

from warpqem.measure.comparison import Comparison, FrameErrors, compare
from warpqem.measure.heatmap import distance_colors, vertex_distances
from warpqem.measure.topology import Topology, topology

__all__ = ["Comparison", "FrameErrors", "Topology", "compare", "distance_colors", "topology", "vertex_distances"]
