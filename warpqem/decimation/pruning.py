"""Pruning of small components: removed where that changes the shape less than the next collapses would.

Collapses take a component no further than to a tetrahedron or a triangle. What is left of it then goes as a whole, once
the cost of that is below the cost threshold of a pass: the least sum of all its quadrics at one point, as if it went
on collapsing to that point, and its area times the squared distance from there to what stays, which then stands for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from warpqem.decimation.collapse_nodes import read_rows
from warpqem.kernels import collapse as kernels
from warpqem.kernels.mesh_state import AnyKeyFrames, MeshState
from warpqem.kernels.pass_control import MAX_REMNANT_FACES
from warpqem.kernels.topology import LOCKED
from warpqem.mesh.components import lowest_members
from warpqem.runtime.launches import launch

__all__ = ["ComponentDrop", "Components", "DropRecord"]

MAX_FACES = int(MAX_REMNANT_FACES)
# A component without area is missed by nobody; below this it has none that float32 could tell.
NO_AREA = 1e-30


@dataclass(frozen=True)
class ComponentDrop:
    """A pruned component.

    Attributes:
        vertex: one of its vertices.
        collapse_count: collapses in the log before.
        face_count: faces that went with it.
        error: RMS distance over key frames, in diagonals, from its faces to what stays.
    """

    vertex: int
    collapse_count: int
    face_count: int
    error: float


@dataclass(frozen=True)
class DropRecord:
    """The D pruned components, in order.

    Attributes:
        vertex_drop: (V,) int32, which of them takes each input vertex; -1 for those that stay.
        collapse_count: (D,) int64, collapses in the log before each.
        face_count: (D,) int64, faces that went with each.
        error: (D,) float32, see :class:`ComponentDrop`.
    """

    vertex_drop: np.ndarray
    collapse_count: np.ndarray
    face_count: np.ndarray
    error: np.ndarray

    def __len__(self) -> int:
        return len(self.collapse_count)

    def head(self, count: int) -> DropRecord:
        """The first ``count`` of them."""
        vertex_drop = np.where(self.vertex_drop < count, self.vertex_drop, np.int32(-1))
        return DropRecord(vertex_drop, self.collapse_count[:count], self.face_count[:count], self.error[:count])

    def chosen(self, dropped: np.ndarray, kept: np.ndarray) -> DropRecord:
        """Some of them, (D,) bool, in a log of some collapses, (C,) bool."""
        number = np.where(dropped, np.cumsum(dropped) - 1, -1).astype(np.int32)
        vertex_drop = np.where(self.vertex_drop >= 0, number[self.vertex_drop], np.int32(-1))
        before = np.concatenate([[0], np.cumsum(kept, dtype=np.int64)])[self.collapse_count[dropped]]
        return DropRecord(vertex_drop, before, self.face_count[dropped], self.error[dropped])

    def for_vertices(self, vertex: np.ndarray) -> DropRecord:
        """The same for vertices in another order: ``vertex`` (V,) is the new number of each."""
        vertex_drop = np.empty_like(self.vertex_drop)
        vertex_drop[vertex] = self.vertex_drop
        return DropRecord(vertex_drop, self.collapse_count, self.face_count, self.error)

    @classmethod
    def none(cls, vertex_count: int) -> DropRecord:
        """All stay."""
        empty = np.zeros(0, dtype=np.int64)
        return cls(np.full(vertex_count, -1, dtype=np.int32), empty, empty, np.zeros(0, dtype=np.float32))


@dataclass(frozen=True)
class _Remnant:
    """What collapses left of a small component."""

    vertex: np.ndarray  # (n,) int32, ascending
    face_count: int
    cost: float
    error: float


class Components:
    """The components of a mesh, which collapses neither join nor part.

    Args:
        state: the mesh, with nothing collapsed yet.
        epsilon: regularisation of a point that follows soft quadrics, relative to them.
        error_limit: squared error, in diagonals squared, beyond which none is pruned.
        last_limit: the same where no edge is left to collapse.

    Attributes:
        count: components with a face.
    """

    def __init__(self, state: MeshState, epsilon: float, error_limit: float, last_limit: float) -> None:
        self._state, self._epsilon = state, epsilon
        self._error_limit, self._last_limit = error_limit, last_limit
        faces = state.corner_vertex.numpy().reshape(-1, 3)
        vertex_count = len(state.vertex_flags)
        lowest = lowest_members(vertex_count, np.concatenate([faces[:, :2], faces[:, 1:]]))
        # Numbered from 0; a vertex without a face is none, but that does no harm.
        _, component = np.unique(lowest, return_inverse=True)
        self._component: np.ndarray = component.ravel()
        with_faces = np.zeros(int(self._component.max(initial=0)) + 1, dtype=bool)
        with_faces[self._component[faces[:, 0]]] = True
        self.count = int(with_faces.sum())
        # A locked vertex stays.
        self._free = np.ones(len(with_faces), dtype=bool)
        self._free[self._component[(state.vertex_flags.numpy() & int(LOCKED)) != 0]] = False

    @property
    def vertex_component(self) -> np.ndarray:
        """(V,) int, the component of each vertex, from 0."""
        return self._component

    @property
    def may_be_pruned(self) -> np.ndarray:
        """(C,) bool, components without a locked vertex."""
        return self._free

    def drop(
        self, frames: AnyKeyFrames, cost_threshold: float, excess: int, collapse_count: int, slot_count: int
    ) -> list[ComponentDrop]:
        """Prune components that cost no more than ``cost_threshold``, the cheapest first, while faces are in excess.

        One component always stays.

        Args:
            frames: positions and quadrics of the key frames.
            cost_threshold: infinite where there is nothing else to do.
            excess: faces beyond those asked for.
            collapse_count: collapses so far.
            slot_count: faces in the arrays, dead ones included.
        """
        first = self._state.corner_vertex[: 3 * slot_count].numpy()[::3]
        sizes = np.bincount(self._component[first[first >= 0]], minlength=len(self._free))
        small = np.flatnonzero((sizes > 0) & (sizes <= MAX_FACES) & self._free)
        if not len(small):
            return []
        left, drops = int(np.count_nonzero(sizes)), []
        remnants = self._remnants(frames, small, slot_count)
        for remnant in sorted(remnants, key=lambda item: (item.cost, int(item.vertex[0]))):
            if excess <= 0 or remnant.cost > cost_threshold or left == 1:
                break
            if remnant.error**2 > (self._last_limit if np.isinf(cost_threshold) else self._error_limit):
                continue
            self._remove(remnant.vertex)
            drops.append(ComponentDrop(int(remnant.vertex[0]), collapse_count, remnant.face_count, remnant.error))
            excess -= remnant.face_count
            left -= 1
        return drops

    def record(self, drops: list[ComponentDrop]) -> DropRecord:
        """The pruned components, by vertex."""
        index = np.full(len(self._free), -1, dtype=np.int32)
        index[self._component[[drop.vertex for drop in drops]]] = np.arange(len(drops))
        return DropRecord(
            index[self._component],
            np.array([drop.collapse_count for drop in drops], dtype=np.int64),
            np.array([drop.face_count for drop in drops], dtype=np.int64),
            np.array([drop.error for drop in drops], dtype=np.float32),
        )

    def _remnants(self, frames: AnyKeyFrames, small: np.ndarray, slot_count: int) -> list[_Remnant]:
        live = self._state.corner_vertex[: 3 * slot_count].numpy().reshape(-1, 3)
        live = live[live[:, 0] >= 0]
        near = _Nearest(frames, np.unique(live), self._component)
        component = self._component[live[:, 0]]
        inside = np.isin(component, small)
        corners = np.stack([np.repeat(component[inside], 3), live[inside].ravel()], axis=1)
        pairs = np.unique(corners, axis=0)
        face_counts = np.bincount(component[inside], minlength=len(self._free)).tolist()
        chosen = wp.array(pairs[:, 1].astype(np.int32), device=frames.position.device)
        position, quadric = (_by_frame(read_rows(array, chosen)) for array in (frames.position, frames.quadric))
        weight = read_rows(self._state.cost_weight, chosen)
        found = []
        for name in small.tolist():
            own = np.flatnonzero(pairs[:, 0] == name)
            total, area = _min_sum(position[own], quadric[own], self._epsilon)
            total += area * near.squared_distance(position[own, 0].mean(axis=0), name)
            error = float(np.sqrt(total / area)) if area > NO_AREA else 0.0
            vertex = pairs[own, 1].astype(np.int32)
            found.append(_Remnant(vertex, face_counts[name], float(weight[own].mean()) * total, error))
        return found

    def _remove(self, vertex: np.ndarray) -> None:
        device = self._state.corner_vertex.device
        launch(
            kernels.remove_from_adjacency,
            dim=len(vertex),
            inputs=[self._state, wp.array(vertex, dtype=wp.int32, device=device)],
            device=device,
        )


class _Nearest:
    """How far the nearest vertex of another component is, in the first key frame."""

    def __init__(self, frames: AnyKeyFrames, vertex: np.ndarray, component: np.ndarray) -> None:
        self._position = frames.position.numpy()[vertex, 0, :, 0]
        self._component = component[vertex]

    def squared_distance(self, point: np.ndarray, component: int) -> float:
        """In diagonals squared, from a point (3,) to what is not of this component."""
        others = self._position[self._component != component]
        return float(((others - point.astype(np.float32)) ** 2).sum(axis=1).min(initial=np.inf))


def _by_frame(blocks: np.ndarray) -> np.ndarray:
    """(n, frames, components) float64 of blocks (n, B, components, width)."""
    rows: np.ndarray = blocks.transpose(0, 1, 3, 2).reshape(len(blocks), -1, blocks.shape[2]).astype(np.float64)
    return rows


def _min_sum(position: np.ndarray, quadric: np.ndarray, epsilon: float) -> tuple[float, float]:
    """Sum over frames of the least of all quadrics together, and of their areas.

    Args:
        position: (n, F, 3) float64, the origins of the quadrics.
        quadric: (n, F, 10) float64.
        epsilon: regularisation towards the middle of the origins.
    """
    matrix = quadric[..., [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(*quadric.shape[:2], 3, 3)
    away = position.mean(axis=0) - position
    bent = np.einsum("nfij,nfj->nfi", matrix, away)
    linear = quadric[..., 6:9] + bent
    constant = quadric[..., 9] + ((quadric[..., 6:9] + linear) * away).sum(axis=-1)
    a, b, c = matrix.sum(axis=0), linear.sum(axis=0), constant.sum(axis=0)
    area = np.trace(a, axis1=1, axis2=2)
    covered = area > NO_AREA
    a, b, c, area = a[covered], b[covered], c[covered], area[covered]
    x = -np.linalg.solve(a + epsilon * area[:, None, None] * np.eye(3), b[..., None])[..., 0]
    value = np.einsum("fi,fij,fj->f", x, a, x) + 2 * (b * x).sum(axis=1) + c
    return float(np.maximum(value, 0.0).sum()), float(area.sum())
