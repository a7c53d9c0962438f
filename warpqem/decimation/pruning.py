"""Pruning of small components: removed where that changes the shape less than the next collapses would.

Collapses take a component no further than to a tetrahedron or a triangle. What is left of it then goes as a whole, once
the cost of that is below the cost threshold of a pass: the area of the component in the input times the squared
distance of its surface from the components that stay, which then stand for it
(:mod:`warpqem.decimation.component_distances`). So edges and components are weighed in one currency, whatever the
quadrics of the present faces still know of the input.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from heapq import heapify, heappop, heappush

import numpy as np
import warp as wp

from warpqem.decimation.collapse_nodes import read_rows
from warpqem.decimation.component_distances import MAX_FRAMES, ComponentDistances
from warpqem.decimation.component_forest import ComponentForest
from warpqem.decimation.recorded_launches import part_work
from warpqem.kernels import collapse as kernels
from warpqem.kernels.components import list_component_faces
from warpqem.kernels.lanes import width_of
from warpqem.kernels.mesh_state import MeshState
from warpqem.kernels.pass_control import MAX_REMNANT_FACES, count_component_faces
from warpqem.kernels.topology import LOCKED
from warpqem.runtime import new_arrays
from warpqem.runtime.launches import launch

__all__ = ["ComponentDrop", "Components", "DropRecord"]

MAX_FACES = int(MAX_REMNANT_FACES)
# A component without area is missed by nobody; below this it has none that float32 could tell.
NO_AREA = 1e-30
# Costs of edges sum the quadrics of both ends, in which each face counts once for each of its three corners. The other
# two: what goes as a whole shows as a gap and is far off in one place, where collapses spread an error. Of 390 parts at
# a twentieth of the faces 1, 3, 6 and 12 leave an RMS error of 0.190, 0.171, 0.166 and 0.166 % and a largest one of
# 2.2, 1.6, 1.4 and 1.2 %.
COST_PER_LOSS = 6.0


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
        if not len(self):
            return self
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

    component: int
    vertex: np.ndarray  # (n,) int32, ascending
    face_count: int
    weight: float  # mean weight of the cost at its vertices


class Components:
    """The components of a mesh, which collapses neither join nor part.

    Args:
        forest: its components, several: one always stays.
        state: the mesh, with nothing collapsed yet.
        key_position: (V, B) blocks of points of the key frames, as the input has them.
        key_count: key frames.
        error_limit: squared error, in diagonals squared, beyond which none is pruned.
        last_limit: the same where no edge is left to collapse.
    """

    def __init__(
        self,
        forest: ComponentForest,
        state: MeshState,
        key_position: wp.array,
        key_count: int,
        error_limit: float,
        last_limit: float,
    ) -> None:
        self._state, self._key_count = state, key_count
        self._error_limit, self._last_limit = error_limit, last_limit
        self._component_of = forest.number()
        self._component: np.ndarray = self._component_of.numpy()
        # A locked vertex stays.
        self._free = np.ones(int(self._component.max(initial=0)) + 1, dtype=bool)
        self._free[self._component[(state.vertex_flags.numpy() & int(LOCKED)) != 0]] = False
        # As the input has them: both are changed by collapses.
        self._corner_vertex, self._points = wp.clone(state.corner_vertex), _chosen_frames(key_position, key_count)

    @cached_property
    def _distances(self) -> ComponentDistances:
        """Found when a component is small for the first time: many meshes never come to that."""
        scale, faces = self._state.quadric_scale.numpy(), self._corner_vertex.numpy().reshape(-1, 3)
        device = str(self._state.corner_vertex.device)
        return ComponentDistances(self._points, faces, self._component, scale, device)

    @property
    def vertex_component(self) -> np.ndarray:
        """(V,) int, the component of each vertex, from 0."""
        return self._component

    @property
    def may_be_pruned(self) -> np.ndarray:
        """(C,) bool, components without a locked vertex."""
        return self._free

    def drop(self, cost_threshold: float, excess: int, collapse_count: int) -> list[ComponentDrop]:
        """Prune components that cost no more than ``cost_threshold``, the cheapest first, while faces are in excess.

        One component always stays. What a component costs is found again when its turn comes: those that went before
        it stand for it no more.

        Args:
            cost_threshold: infinite where there is nothing else to do.
            excess: faces beyond those asked for.
            collapse_count: collapses so far.
        """
        sizes = self._live_sizes()
        small = np.flatnonzero((sizes > 0) & (sizes <= MAX_FACES) & self._free)
        if not len(small):
            return []
        stays, drops = sizes > 0, []
        left = int(np.count_nonzero(stays))
        remnants = self._remnants(small, sizes)
        waiting = [(*self._loss(remnant, stays), i) for i, remnant in enumerate(remnants)]
        heapify(waiting)
        while waiting and excess > 0 and left > 1:
            _, _, i = heappop(waiting)
            remnant = remnants[i]
            cost, error = self._loss(remnant, stays)
            if waiting and (cost, error, i) > waiting[0]:
                heappush(waiting, (cost, error, i))
                continue
            if cost > cost_threshold:
                break
            if error**2 > (self._last_limit if np.isinf(cost_threshold) else self._error_limit):
                continue
            self._remove(remnant.vertex)
            drops.append(ComponentDrop(int(remnant.vertex[0]), collapse_count, remnant.face_count, error))
            excess -= remnant.face_count
            stays[remnant.component] = False
            left -= 1
        return drops

    def _loss(self, remnant: _Remnant, stays: np.ndarray) -> tuple[float, float]:
        """What it costs that a component goes, on the scale of edges, and the RMS distance of it from what stays."""
        others = stays.copy()
        others[remnant.component] = False
        area, lost = self._distances.loss(remnant.component, others)
        error = float(np.sqrt(lost / area)) if area > NO_AREA else 0.0
        return COST_PER_LOSS * self._key_count * remnant.weight * lost, error

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

    def _live_sizes(self) -> np.ndarray:
        """(C,) int32, live faces of each component."""
        device = self._state.corner_vertex.device
        sizes, work = new_arrays.zeros(len(self._free), dtype=wp.int32, device=device), part_work(0, 1, str(device))
        inputs = [self._state, self._component_of, work]
        launch(count_component_faces, work.thread_count, inputs, [sizes], device=device)
        return np.array(sizes.numpy())

    def _live_faces(self, small: np.ndarray, count: int) -> np.ndarray:
        """(count, 3) int32, the live faces of some components, in no order."""
        device = self._state.corner_vertex.device
        chosen = np.zeros(len(self._free), dtype=np.int32)
        chosen[small] = 1
        listed, faces = (new_arrays.zeros(n, dtype=t, device=device) for n, t in ((1, wp.int32), (count, wp.vec3i)))
        work, of_component = part_work(0, 1, str(device)), wp.array(chosen, device=device)
        inputs = [self._state.corner_vertex, self._state.face_count, self._component_of, of_component, work]
        launch(list_component_faces, work.thread_count, inputs, [listed, faces], device=device)
        return np.array(faces.numpy())

    def _remnants(self, small: np.ndarray, sizes: np.ndarray) -> list[_Remnant]:
        faces = self._live_faces(small, int(sizes[small].sum()))
        corners = np.stack([np.repeat(self._component[faces[:, 0]], 3), faces.ravel()], axis=1)
        pairs = np.unique(corners, axis=0)
        start = np.searchsorted(pairs[:, 0], small)
        vertex = pairs[:, 1].astype(np.int32)
        weight = read_rows(self._state.cost_weight, wp.array(vertex, device=self._state.corner_vertex.device))
        parts = zip(small.tolist(), np.split(vertex, start[1:]), np.split(weight, start[1:]), strict=True)
        return [_Remnant(c, v, int(sizes[c]), float(w.mean())) for c, v, w in parts]

    def _remove(self, vertex: np.ndarray) -> None:
        device = self._state.corner_vertex.device
        launch(
            kernels.remove_from_adjacency,
            dim=len(vertex),
            inputs=[self._state, new_arrays.uploaded(vertex, dtype=wp.int32, device=device)],
            device=device,
        )


def _chosen_frames(key_position: wp.array, key_count: int) -> np.ndarray:
    """(K', V, 3) float32, some of the key frames, evenly spread."""
    chosen = np.unique(np.linspace(0, key_count - 1, min(key_count, MAX_FRAMES)).round().astype(np.int64))
    width = width_of(key_position)
    # One block at a time: all of them are the most memory that there is in ordering.
    blocks = ((key_position[:, k // width : k // width + 1].numpy(), k % width) for k in chosen.tolist())
    return np.stack([block[:, 0, :, lane] for block, lane in blocks])
