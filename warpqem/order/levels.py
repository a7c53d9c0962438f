"""Levels of one ordering: the state that it had after any number of its collapses."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from warpqem.order.cut import Cut, last_collapses
from warpqem.order.nodes import NodeRecorder, PassNodes
from warpqem.order.stage import OrderedMesh, faces_left

__all__ = ["MergedClusters", "OrderedLevels"]


@dataclass(frozen=True)
class MergedClusters:
    """The clusters that one pass merged.

    Attributes:
        collapse: (n,) int, the collapses in the log that made them, by the vertex kept.
        kept: (n,) int32, the input vertex that each goes by, ascending.
        cluster: (V,) int32, the cluster of each input vertex, -1 where there is none.
        ordered: the mesh with its state at each of ``kept``.
    """

    collapse: np.ndarray
    kept: np.ndarray
    cluster: np.ndarray
    ordered: OrderedMesh


class OrderedLevels:
    """All that placing needs of any level between the input and what ordering left.

    Args:
        input_faces: (N, 3) int32, what was ordered.
        ordered: what that left.
        recorder: what it recorded on the way.
    """

    def __init__(self, input_faces: np.ndarray, ordered: OrderedMesh, recorder: NodeRecorder) -> None:
        self._input_faces, self._ordered, self._passes = input_faces, ordered, recorder.passes
        self.log = ordered.log
        self._position, self._quadric = wp.clone(ordered.position), wp.clone(ordered.quadric)
        # Collapses and drops in the order they came, the drops counted on from the last collapse.
        collapse, after = np.arange(len(self.log)), ordered.drops.collapse_count
        self._event = np.argsort(np.concatenate([2 * collapse + 1, 2 * after]), kind="stable")
        sizes = [len(nodes.row) for nodes in self._passes]
        self._vertex_of_row = np.argsort(ordered.row)
        # The collapse that each vertex's state is that after, of those that a cut asks for.
        self._shown = last_collapses(self.log, np.ones(len(self.log), dtype=bool), len(ordered.row))
        # The log is sorted by round, so each pass owns a run of it.
        self._pass_start = np.concatenate([[0], np.cumsum(sizes, dtype=np.int64)])

    def steps_to(self, target_faces: int) -> int:
        """The least number of collapses and drops that leaves so many faces or fewer; all of them where none does."""
        counts = np.concatenate([self.log.faces_removed, self._ordered.drops.face_count])[self._event]
        left = len(self._input_faces) - np.concatenate([[0], np.cumsum(counts, dtype=np.int64)])
        return min(int(np.searchsorted(-left, -target_faces)), len(self._event))

    def at(self, step_count: int) -> OrderedMesh:
        """What ordering would have left after so many collapses and drops.

        The arrays of positions and quadrics are shared by all levels: one level is placed before the next is asked for.
        """
        self._shown[:] = -1
        collapse_count = int((self._event[:step_count] < len(self.log)).sum())
        drops = self._ordered.drops.head(step_count - collapse_count)
        for index, nodes in enumerate(self._passes):
            first = int(self._pass_start[index])
            if first < collapse_count:
                wanted = np.isin(self._vertex_of_row[nodes.row], self.log.kept[first:collapse_count])
                self._show(nodes, wanted)
        log = self.log.head(collapse_count)
        root = log.roots(len(self._ordered.root))
        faces = root[self._input_faces]
        face_map = faces_left(self._input_faces, faces, drops)
        at_end = step_count == len(self._event)
        return replace(
            self._ordered,
            faces=faces[face_map],
            face_map=face_map,
            root=root,
            position=self._position,
            quadric=self._quadric,
            stopped=self._ordered.stopped if at_end else "target",
            log=log,
            drops=drops,
        )

    def at_cut(self, cut: Cut) -> OrderedMesh:
        """The level of a cut, see :mod:`warpqem.order.cut`; arrays are shared as with :meth:`at`."""
        last = last_collapses(self.log, cut.kept, len(self._vertex_of_row))
        # What is there already need not be shown; input vertices need no state.
        changed = np.flatnonzero((last != self._shown) & (last >= 0))
        of_pass = np.searchsorted(self._pass_start, last[changed], side="right") - 1
        for index in np.unique(of_pass).tolist():
            nodes, wanted = self._passes[index], np.zeros(len(self._vertex_of_row), dtype=bool)
            wanted[changed[of_pass == index]] = True
            self._show(nodes, wanted[self._vertex_of_row[nodes.row]])
        self._shown[changed] = last[changed]
        log = self.log.chosen(cut.kept)
        drops = self._ordered.drops
        drops = drops.chosen(cut.dropped, cut.kept) if len(drops) else drops
        root = log.roots(len(self._ordered.root))
        faces = root[self._input_faces]
        face_map = faces_left(self._input_faces, faces, drops)
        return replace(
            self._ordered,
            faces=faces[face_map],
            face_map=face_map,
            root=root,
            position=self._position,
            quadric=self._quadric,
            log=log,
            drops=drops,
        )

    def merged_clusters(self) -> Iterator[MergedClusters]:
        """The clusters that each pass merged, pass after pass; each is placed before the next is asked for."""
        root = np.arange(len(self._ordered.root), dtype=np.int32)
        for index, nodes in enumerate(self._passes):
            part = slice(int(self._pass_start[index]), int(self._pass_start[index + 1]))
            parent = np.arange(len(root), dtype=np.int32)
            parent[self.log.removed[part]] = self.log.kept[part]
            root = parent[root]
            place = np.full(len(root), -1, dtype=np.int32)
            kept = np.sort(self.log.kept[part])
            place[kept] = np.arange(len(kept), dtype=np.int32)
            cluster = place[root]
            self._shown[:] = -1
            self._show(nodes, np.ones(len(kept), dtype=bool))
            inside = np.where(cluster >= 0, root, -1).astype(np.int32)
            ordered = replace(self._ordered, root=inside, position=self._position, quadric=self._quadric)
            collapse = part.start + np.argsort(self.log.kept[part])
            yield MergedClusters(collapse, kept, cluster, ordered)

    def _show(self, nodes: PassNodes, wanted: np.ndarray) -> None:
        """Put the recorded state of some vertices in place."""
        device = self._position.device
        row = wp.array(nodes.row[wanted], dtype=wp.int32, device=device)
        for array, values in ((self._position, nodes.position), (self._quadric, nodes.quadric)):
            wp.copy(wp.indexedarray(array, [row]), wp.array(values[wanted], dtype=array.dtype, device=device))
