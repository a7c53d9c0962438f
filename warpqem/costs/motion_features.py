"""Motion features: the parts of a surface that bend while it moves (joints).

After Yang, Zhou, Lin, Lin & Lin, "Animated mesh simplification based on motion features in visual sensor networks",
2019: an edge is connected where its dihedral angle changes faster than the mean over all edges, and by more than one
degree; connected components are the features; a vertex weighs as much as its feature has vertices. Threshold, limit and
weights are options: that paper leaves finer features and better weights for later.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp

from warpqem.arguments.array_record import ArrayRecord
from warpqem.arguments.array_types import ArrayInput, MeshPoints
from warpqem.arguments.limits import Limits
from warpqem.arguments.number_input import real_number
from warpqem.costs.weights import check_factors
from warpqem.errors import OptionError
from warpqem.frames.blocks import chunk_steps
from warpqem.frames.device_frames import to_device
from warpqem.kernels import motion as kernels
from warpqem.mesh.components import lowest_members
from warpqem.mesh.edges import edge_table
from warpqem.mesh.mesh_input import MeshInput, measure_mesh, read_mesh
from warpqem.runtime.device import array_device, on_device, resolve_device
from warpqem.runtime.launches import launch

__all__ = ["FEATURE_WEIGHTS", "MotionFeatures", "MotionWatch", "MotionWeighting", "motion_features", "motion_weighting"]

# Below one degree between two frames a change of angle is rounding, not motion (the paper's limit).
FLOOR_DEGREES = 1.0
# A dihedral angle changes by half a turn at most.
HALF_TURN = Limits(0.0, 180.0)
DEGREES = f"{HALF_TURN} degrees"
FEATURE_WEIGHTS = ("size", "root", "log", "bend")


@dataclass(frozen=True, eq=False, repr=False)
class MotionFeatures(ArrayRecord):
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


@dataclass(frozen=True)
class MotionWeighting:
    """How motion features are found, and what a vertex in one weighs in the cost of ``metric="aqem"``.

    Attributes:
        threshold: degrees that the dihedral angle of an edge must change by between two frames to be part of a feature;
            None for the mean over all edges, as in the paper. A lower one finds finer features.
        floor: degrees that it must change by in any case, 0 or more; 1 in the paper.
        weight: "size", vertices of the feature, as in the paper; "root" or "log", the square root of that, or one plus
            its logarithm; "bend", how many times the threshold the feature's edges at the vertex change on average; or
            a function that gets the :class:`MotionFeatures`, weighted by size, and returns factors from 0 to 1e12,
            (V,). Outside of features a vertex weighs 1 by all but the last.
    """

    threshold: float | None = None
    floor: float = FLOOR_DEGREES
    weight: str | Callable[[MotionFeatures], ArrayInput] = "size"

    def __post_init__(self) -> None:
        """Refuse angles that are none, and weights that there are not."""
        if self.threshold is not None:
            real_number(self.threshold, "threshold of motion features", DEGREES, HALF_TURN.__contains__)
        real_number(self.floor, "floor of motion features", DEGREES, HALF_TURN.__contains__)
        if not callable(self.weight) and self.weight not in FEATURE_WEIGHTS:
            raise OptionError(
                f"weight of motion features {self.weight!r}: expected a function or one of {', '.join(FEATURE_WEIGHTS)}"
            )


def motion_weighting(
    threshold: float | None = None, floor: float | None = None, weight: str | None = None
) -> MotionWeighting | None:
    """Those that are not None; None where all are.

    Raises:
        OptionError: an angle or a weight is none.
    """
    asked = {"threshold": threshold, "floor": floor, "weight": weight}
    given: dict[str, Any] = {name: value for name, value in asked.items() if value is not None}
    return MotionWeighting(**given) if given else None


@on_device
def motion_features(
    points: MeshPoints,
    faces: ArrayInput | None = None,
    *,
    weighting: MotionWeighting | None = None,
    device: str | None = None,
) -> MotionFeatures:
    """Find the motion features over all frames.

    Args:
        points: (F, V, 3), any unit, or a :class:`warpqem.FrameSource`.
        faces: (N, 3) int.
        weighting: threshold and weights; None for those of the paper.
        device: Warp device; None takes cuda:0 if present, else cpu.

    Raises:
        OptionError: the weights that a function returned are none.
        WarpqemError: as for :func:`warpqem.simplify`.
    """
    device = resolve_device(device)
    mesh = read_mesh(points, faces, device=device if array_device(points) is not None else None)
    watch = MotionWatch(mesh, device, weighting)
    measure_mesh(mesh, device, [watch])
    return watch.features()


class MotionWatch:
    """Measures the dihedral angles of all edges while the frames are read.

    Args:
        mesh: the mesh.
        device: Warp device.
        weighting: threshold and weights; None for those of the paper.
    """

    def __init__(self, mesh: MeshInput, device: str, weighting: MotionWeighting | None = None) -> None:
        self._device, self._vertex_count = device, mesh.vertex_count
        self._weighting = MotionWeighting() if weighting is None else weighting
        self._table = edge_table(mesh.faces)
        self._inner = self._table.face_count == 2
        edges = np.concatenate([self._table.ends[self._inner], self._table.opposites[self._inner]], axis=1)
        self._edge = wp.array(edges, dtype=wp.int32, device=device)
        self._change = wp.zeros(len(edges), dtype=wp.float32, device=device)
        # The last frame seen, and the first of the block after it.
        self._pair: wp.array | None = None

    def observe(self, frames: slice, points: np.ndarray | wp.array) -> None:
        """Take on the largest change of each angle over these frames and the one before them.

        They are (n, V, 3), or (n, V) points on the device.
        """
        there = to_device(points, self._device) if isinstance(points, np.ndarray) else points
        if self._pair is None:
            self._pair = wp.empty((2, self._vertex_count), dtype=wp.vec3, device=self._device)
        else:
            wp.copy(self._pair[1:], there[:1])
            self._measure(self._pair)
        self._measure(there)
        wp.copy(self._pair[:1], there[len(there) - 1 :])

    def _measure(self, points: wp.array) -> None:
        steps = len(points) - 1
        if steps < 1 or not len(self._edge):
            return
        chunk = chunk_steps(steps, len(self._edge), self._device)
        launch(
            kernels.measure_dihedral_changes,
            dim=(-(-steps // chunk), len(self._edge)),
            inputs=[self._edge, points, chunk],
            outputs=[self._change],
            device=self._device,
        )

    def features(self) -> MotionFeatures:
        """The features, once all frames have been seen."""
        table = self._table
        factor = np.zeros(len(table.ends), dtype=np.float32)
        factor[self._inner] = np.degrees(self._change.numpy())
        asked = self._weighting
        mean = float(factor.mean(dtype=np.float64)) if asked.threshold is None else asked.threshold
        threshold = max(mean, asked.floor)
        connected = (factor > threshold) | (table.face_count == 1)
        label, weight = _components(self._vertex_count, table.ends[connected])
        return _weighted(MotionFeatures(label, weight, table.ends, factor, threshold), asked.weight)


def _weighted(features: MotionFeatures, weight: str | Callable[[MotionFeatures], ArrayInput]) -> MotionFeatures:
    """The features, weighted by size, with other weights."""
    if weight == "size":
        return features
    if callable(weight):
        own = check_factors(weight(features), len(features.weight), "the weights of motion features: the function gave")
    elif weight == "bend":
        own = _bend(features)
    else:
        own = np.sqrt(features.weight) if weight == "root" else 1.0 + np.log(features.weight)
    return replace(features, weight=own.astype(np.float32))


def _bend(features: MotionFeatures) -> np.ndarray:
    """Mean change of the connected edges at each vertex, in thresholds, (V,); 1 without any and at borders alone."""
    bending = features.factor > features.threshold
    ends = features.edges[bending]
    # A threshold of 0 degrees has no multiples.
    share = features.factor[bending] / max(features.threshold, np.finfo(np.float32).tiny)
    vertex_count = len(features.label)
    total = sum(np.bincount(ends[:, side], share, vertex_count) for side in (0, 1))
    count = sum(np.bincount(ends[:, side], minlength=vertex_count) for side in (0, 1))
    return np.where(count > 0, total / np.maximum(count, 1), 1.0)


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
