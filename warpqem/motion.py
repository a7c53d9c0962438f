"""Motion features: the parts of a surface that bend while it moves (joints).

After Yang, Zhou, Lin, Lin & Lin, "Animated mesh simplification based on motion features in visual sensor networks",
2019: an edge is connected where its dihedral angle changes faster than the mean over all edges, and by more than one
degree; connected components are the features; a vertex weighs as much as its feature has vertices.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from warpqem.components import lowest_members
from warpqem.device import resolve_device
from warpqem.edges import edge_table
from warpqem.kernels import motion as kernels
from warpqem.mesh_input import read_mesh

__all__ = ["MotionFeatures", "motion_features"]

# Below one degree between two frames a change of angle is rounding, not motion (the paper's limit).
LEAST_CHANGE_DEGREES = 1.0


@dataclass(frozen=True)
class MotionFeatures:
    """Motion features of an animated mesh.

    Attributes:
        label: (V,) int32, the feature of each vertex, -1 outside; features are numbered by their lowest vertex.
        weight: (V,) float32, vertices in the vertex's feature, 1 outside.
        edges: (E, 2) int32, all edges.
        factor: (E,) float32, degrees, largest change of the dihedral angle between two frames; 0 at borders.
        threshold: degrees above which an edge is connected.
    """

    label: np.ndarray
    weight: np.ndarray
    edges: np.ndarray
    factor: np.ndarray
    threshold: float

    @property
    def feature_count(self) -> int:
        """Number of features."""
        return int(self.label.max(initial=-1)) + 1


def motion_features(points: Any, faces: Any = None, *, device: str | None = None) -> MotionFeatures:
    """Find the motion features over all frames.

    Args:
        points: (F, V, 3), any unit.
        faces: (N, 3) int.
        device: Warp device; None takes cuda:0 if present, else cpu.

    Raises:
        WarpqemError: as for :func:`warpqem.simplify`.
    """
    mesh = read_mesh(points, faces)
    device = resolve_device(device)
    table = edge_table(mesh.faces)
    inner = table.face_count == 2
    factor = np.zeros(len(table.ends), dtype=np.float32)
    factor[inner] = _dihedral_changes(mesh.points, table.ends[inner], table.wings[inner], device)
    threshold = max(float(factor.mean(dtype=np.float64)), LEAST_CHANGE_DEGREES)
    connected = (factor > threshold) | (table.face_count == 1)
    label, weight = _components(mesh.vertex_count, table.ends[connected])
    return MotionFeatures(label, weight, table.ends, factor, threshold)


def _dihedral_changes(points: np.ndarray, ends: np.ndarray, wings: np.ndarray, device: str) -> np.ndarray:
    """Largest change in degrees between consecutive frames, (E,)."""
    change = wp.zeros(len(ends), dtype=wp.float32, device=device)
    edge = wp.array(np.concatenate([ends, wings], axis=1), dtype=wp.int32, device=device)
    wp.launch(
        kernels.measure_dihedral_changes,
        dim=len(ends),
        inputs=[edge, wp.array(points, dtype=wp.vec3, device=device)],
        outputs=[change],
        device=device,
    )
    return np.degrees(change.numpy())


def _components(vertex_count: int, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Label and size of the connected component of each vertex; -1 and 1 for vertices without an edge."""
    lowest = lowest_members(vertex_count, edges)
    inside = np.zeros(vertex_count, dtype=bool)
    inside[edges] = True
    label = np.full(vertex_count, -1, dtype=np.int32)
    weight = np.ones(vertex_count, dtype=np.float32)
    _, label[inside], size = np.unique(lowest[inside], return_inverse=True, return_counts=True)
    weight[inside] = size[label[inside]]
    return label, weight
