"""Pruning of small components: removed where that changes the shape less than the next collapses would.

Collapses take a component no further than to a tetrahedron or a triangle; one with a hole through it, such as a ring,
not even there. What is left of it then goes as a whole, once the cost of that is below the cost threshold of a pass:
the area of the component in the input times the squared distance of its surface from the components that stay, which
then stand for it (:mod:`warpqem.decimation.component_distances`). So edges and components are weighed in one currency,
whatever the quadrics of the present faces still know of the input.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from heapq import heapify, heappop, heappush

import numpy as np
import warp as wp

from warpqem.decimation.collapse_nodes import read_rows
from warpqem.decimation.component_distances import MAX_FRAMES, ComponentDistances, least_losses
from warpqem.decimation.component_forest import ComponentForest
from warpqem.decimation.recorded_launches import part_work
from warpqem.kernels import collapse as kernels
from warpqem.kernels.components import MAX_REMNANT_FACES, list_component_faces, mark_remnants, measure_components
from warpqem.kernels.lanes import width_of
from warpqem.kernels.mesh_state import MeshState
from warpqem.kernels.topology import LOCKED
from warpqem.runtime import new_arrays
from warpqem.runtime.launches import launch

__all__ = ["ComponentDrop", "Components", "DropRecord"]

# A component without area is missed by nobody; below this it has none that float32 could tell.
NO_AREA = 1e-30
# What a loss is at least is compared in float32, and is to come out no higher there than what it is.
ROUNDED_DOWN = 1.0 - 1e-6
# Costs of edges sum the quadrics of both ends, in which each face counts once for each of its three corners: that is
# six. The other four: what goes as a whole shows as a gap and is far off in one place, where collapses spread an error
# and a refit takes most of it back. Fourteen clips and eight assemblies at 25, 10 and 5 %, beside 48: 6, 12 and 24
# leave RMS errors of 0.973, 0.984 and 0.983, largest distances of 1.005, 0.994 and 0.986.
COST_PER_LOSS = 24.0


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

    def vertices_of_largest(self, count: int, face_count: int) -> np.ndarray:
        """(V,) bool, input vertices of the so many that went with most faces after a collapse, each more than a number.

        Args:
            count: components at most.
            face_count: those that went with no more faces are left out.
        """
        size = np.where(self.collapse_count > 0, self.face_count, 0)
        largest = np.argsort(-size, kind="stable")[:count]
        # The last place stands for vertices that stay.
        is_chosen = np.zeros(len(size) + 1, dtype=bool)
        is_chosen[largest[size[largest] > face_count]] = True
        vertices: np.ndarray = is_chosen[self.vertex_drop]
        return vertices

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
        last_limit: the same where no edge is left to collapse, and of parts that are no remnants.
        gone: (V,) bool, vertices whose components go before all else; None for none.

    Attributes:
        least_loss: (C,) float32 on the device, the least that each component's loss can come to, as far as that is
            known, on the scale of edges; infinite for one with a locked vertex.
    """

    def __init__(
        self,
        forest: ComponentForest,
        state: MeshState,
        key_position: wp.array,
        key_count: int,
        error_limit: float,
        last_limit: float,
        gone: np.ndarray | None = None,
    ) -> None:
        self._state, self._scale = state, COST_PER_LOSS * key_count
        self._error_limit, self._last_limit = error_limit, last_limit
        self._component_of = forest.number()
        self._component: np.ndarray = self._component_of.numpy()
        self._gone = np.empty(0, dtype=self._component.dtype) if gone is None else np.unique(self._component[gone])
        # A locked vertex stays. Of the others nothing is known until one may be pruned.
        self._least = np.zeros(int(self._component.max(initial=0)) + 1)
        self._least[self._component[(state.vertex_flags.numpy() & int(LOCKED)) != 0]] = np.inf
        self.least_loss = wp.array(self._least, dtype=wp.float32, device=state.corner_vertex.device)
        self._least_scale = ROUNDED_DOWN * self._scale * float(state.cost_weight.numpy().min(initial=np.inf))
        # As the input has them: both are changed by collapses.
        self._corner_vertex, self._points = wp.clone(state.corner_vertex), _chosen_frames(key_position, key_count)

    @cached_property
    def _distances(self) -> ComponentDistances:
        """Found when a component is small for the first time: many meshes never come to that."""
        return ComponentDistances(*self._surface, str(self._state.corner_vertex.device))

    @cached_property
    def _surface(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The input, as :class:`ComponentDistances` takes it."""
        faces, scale = self._corner_vertex.numpy().reshape(-1, 3), self._state.quadric_scale.numpy()
        return self._points, faces, self._component, scale

    @property
    def vertex_component(self) -> np.ndarray:
        """(V,) int, the component of each vertex, from 0."""
        return self._component

    def drop_first(self) -> list[ComponentDrop]:
        """Prune those that go before all else."""
        if not len(self._gone):
            return []
        sizes, _ = self._measured(0.0)
        stays = sizes > 0
        stays[self._gone] = False
        drops = []
        for remnant in self._remnants(self._gone, sizes):
            _, error = self._loss(remnant, stays)
            drops.append(self._removed(remnant, 0, error))
        return drops

    def drop(self, cost_threshold: float, excess: int, collapse_count: int) -> list[ComponentDrop]:
        """Prune components that cost no more than ``cost_threshold``, the cheapest first, while faces are in excess.

        One component always stays. What a component costs is found again when its turn comes: those that went before
        it stand for it no more.

        Args:
            cost_threshold: infinite where there is nothing else to do.
            excess: faces beyond those asked for.
            collapse_count: collapses so far.
        """
        sizes, small = self._measured(cost_threshold)
        unknown = small[self._least[small] == 0]
        if len(unknown):
            self._least[unknown] = self._least_scale * least_losses(*self._surface, unknown)
            self.least_loss.assign(self._least.astype(np.float32))
            sizes, small = self._measured(cost_threshold)
        if not len(small):
            return []
        stays, drops, is_due = sizes > 0, [], not np.isinf(cost_threshold)
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
            is_small = remnant.face_count <= int(MAX_REMNANT_FACES)
            # What is larger than the excess would leave the mesh short of faces that edges can still give.
            if remnant.face_count >= excess + int(MAX_REMNANT_FACES) and is_due:
                continue
            if error**2 > (self._error_limit if is_due and is_small else self._last_limit):
                continue
            drops.append(self._removed(remnant, collapse_count, error))
            excess -= remnant.face_count
            stays[remnant.component] = False
            left -= 1
        self.least_loss.assign(self._least.astype(np.float32))
        return drops

    def _loss(self, remnant: _Remnant, stays: np.ndarray) -> tuple[float, float]:
        """What it costs that a component goes, on the scale of edges, and the RMS distance of it from what stays.

        The cost is that of :data:`MAX_REMNANT_FACES` faces: one that is left with more gives more for the same loss.
        """
        others = stays.copy()
        others[remnant.component] = False
        area, lost = self._distances.loss(remnant.component, others)
        error = float(np.sqrt(lost / area)) if area > NO_AREA else 0.0
        # The more components have gone, the further away is what stays: the loss only grows.
        self._least[remnant.component] = self._least_scale * lost
        # As warpqem.kernels.components.cost_of_loss has it for the device.
        share = min(1.0, int(MAX_REMNANT_FACES) / remnant.face_count)
        return self._scale * remnant.weight * lost * share, error

    def record(self, drops: list[ComponentDrop]) -> DropRecord:
        """The pruned components, by vertex."""
        index = np.full(len(self._least), -1, dtype=np.int32)
        index[self._component[[drop.vertex for drop in drops]]] = np.arange(len(drops))
        return DropRecord(
            index[self._component],
            np.array([drop.collapse_count for drop in drops], dtype=np.int64),
            np.array([drop.face_count for drop in drops], dtype=np.int64),
            np.array([drop.error for drop in drops], dtype=np.float32),
        )

    def _measured(self, cost_threshold: float) -> tuple[np.ndarray, np.ndarray]:
        """(C,) int32, live faces of each component; and which components may be pruned, ascending."""
        device = self._state.corner_vertex.device
        work = part_work(0, 1, str(device))
        sizes, cheapness, marks = (new_arrays.zeros(len(self._least), dtype=wp.int32, device=device) for _ in range(3))
        inputs = [self._state, self._component_of, work]
        launch(measure_components, work.thread_count, inputs, [sizes, cheapness], device=device)
        threshold = wp.array([cost_threshold], dtype=wp.float32, device=device)
        inputs = [sizes, cheapness, self.least_loss, threshold, work]
        launch(
            mark_remnants, work.thread_count, inputs, [marks, wp.zeros(1, dtype=wp.int32, device=device)], device=device
        )
        return np.array(sizes.numpy()), np.flatnonzero(marks.numpy())

    def _live_faces(self, small: np.ndarray, count: int) -> np.ndarray:
        """(count, 3) int32, the live faces of some components, in no order."""
        device = self._state.corner_vertex.device
        chosen = np.zeros(len(self._least), dtype=np.int32)
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

    def _removed(self, remnant: _Remnant, collapse_count: int, error: float) -> ComponentDrop:
        """Take a component off the mesh."""
        device = self._state.corner_vertex.device
        launch(
            kernels.remove_from_adjacency,
            dim=len(remnant.vertex),
            inputs=[self._state, new_arrays.uploaded(remnant.vertex, dtype=wp.int32, device=device)],
            device=device,
        )
        return ComponentDrop(int(remnant.vertex[0]), collapse_count, remnant.face_count, error)


def _chosen_frames(key_position: wp.array, key_count: int) -> np.ndarray:
    """(K', V, 3) float32, some of the key frames, evenly spread."""
    chosen = np.unique(np.linspace(0, key_count - 1, min(key_count, MAX_FRAMES)).round().astype(np.int64))
    width = width_of(key_position)
    # One block at a time: all of them are the most memory that there is in ordering.
    blocks = ((key_position[:, k // width : k // width + 1].numpy(), k % width) for k in chosen.tolist())
    return np.stack([block[:, 0, :, lane] for block, lane in blocks])
