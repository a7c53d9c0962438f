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
from warpqem.device import on_device, resolve_device
from warpqem.edges import edge_table
from warpqem.kernels import motion as kernels
from warpqem.launches import launch
from warpqem.mesh_input import MeshInput, measure_mesh, read_mesh

__all__ = ["MotionFeatures", "MotionWatch", "motion_features"]

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


@on_device
def motion_features(points: Any, faces: Any = None, *, device: str | None = None) -> MotionFeatures:
    """Find the motion features over all frames.

    Args:
        points: (F, V, 3), any unit, or a :class:`warpqem.FrameSource`.
        faces: (N, 3) int.
        device: Warp device; None takes cuda:0 if present, else cpu.

    Raises:
        WarpqemError: as for :func:`warpqem.simplify`.
    """
    device = resolve_device(device)
    mesh = read_mesh(points, faces)
    watch = MotionWatch(mesh, device)
    measure_mesh(mesh, [watch])
    return watch.features()


class MotionWatch:
    """Measures the dihedral angles of all edges while the frames are read.

    Args:
        mesh: the mesh.
        device: Warp device.
    """

    def __init__(self, mesh: MeshInput, device: str) -> None:
        self._device, self._vertex_count = device, mesh.vertex_count
        self._table = edge_table(mesh.faces)
        self._inner = self._table.face_count == 2
        edges = np.concatenate([self._table.ends[self._inner], self._table.wings[self._inner]], axis=1)
        self._edge = wp.array(edges, dtype=wp.int32, device=device)
        self._change = wp.zeros(len(edges), dtype=wp.float32, device=device)
        self._last = np.empty((0, mesh.vertex_count, 3), dtype=np.float32)

    def observe(self, frames: slice, points: np.ndarray) -> None:
        """Take on the largest change of each angle over these frames (n, V, 3) and the one before them."""
        if len(self._last):
            self._measure(np.concatenate([self._last, points[:1]]))
        self._measure(points)
        self._last = points[-1:].copy()

    def _measure(self, points: np.ndarray) -> None:
        launch(
            kernels.measure_dihedral_changes,
            dim=len(self._edge),
            inputs=[self._edge, wp.array(points, dtype=wp.vec3, device=self._device, copy=False)],
            outputs=[self._change],
            device=self._device,
        )

    def features(self) -> MotionFeatures:
        """The features, once all frames have been seen."""
        table = self._table
        factor = np.zeros(len(table.ends), dtype=np.float32)
        factor[self._inner] = np.degrees(self._change.numpy())
        threshold = max(float(factor.mean(dtype=np.float64)), LEAST_CHANGE_DEGREES)
        connected = (factor > threshold) | (table.face_count == 1)
        label, weight = _components(self._vertex_count, table.ends[connected])
        return MotionFeatures(label, weight, table.ends, factor, threshold)


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
