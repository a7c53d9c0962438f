"""Levels of one ordering: the state that it had after any number of its collapses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from warpqem.decimation.collapse_nodes import NodeRecorder, PassNodes, read_rows
from warpqem.decimation.decimate import DecimatedMesh
from warpqem.decimation.faces_left import faces_left
from warpqem.decimation.forest_cut import Cut, last_collapses
from warpqem.decimation.memoryless_quadrics import MemorylessQuadrics
from warpqem.decimation.order_steps import OrderSteps
from warpqem.runtime import new_arrays

__all__ = ["MergedClusters", "OrderedLevels", "put_rows"]


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
    ordered: DecimatedMesh


class OrderedLevels:
    """All that placing needs of any level between the input and what ordering left.

    Args:
        input_faces: (N, 3) int32, what was ordered.
        ordered: what that left.
        recorder: what it recorded on the way.
    """

    def __init__(self, input_faces: np.ndarray, ordered: DecimatedMesh, recorder: NodeRecorder) -> None:
        self._ordered, self._passes, self._input_faces = ordered, recorder.passes, input_faces
        self._corner_vertex = new_arrays.uploaded(input_faces.ravel(), dtype=wp.int32, device=ordered.position.device)
        self.log = ordered.log.made()
        self._position, self._quadric = wp.clone(ordered.position), wp.clone(ordered.quadric)
        self._present = MemorylessQuadrics(input_faces, ordered) if recorder.present else None
        self._steps = OrderSteps(self.log, ordered.drops, len(input_faces))
        sizes = [len(nodes.row) for nodes in self._passes]
        self._vertex_of_row = np.argsort(ordered.row)
        # The collapse that each vertex's state is that after, of those that a cut asks for.
        self._shown = last_collapses(self.log, np.ones(len(self.log), dtype=bool), len(ordered.row))
        # The log is sorted by round, so each pass owns a run of it.
        self._pass_start = np.concatenate([[0], np.cumsum(sizes, dtype=np.int64)])

    @property
    def held_bytes(self) -> int:
        """Bytes of the states that it keeps, on the host and on the device."""
        nodes = sum(part.held_bytes for part in self._passes)
        arrays = (self._position, self._quadric, self._ordered.position, self._ordered.quadric)
        return nodes + sum(array.capacity for array in (*arrays, self._ordered.key_position))

    def steps_to(self, target_faces: int) -> int:
        """The least number of collapses and drops that leaves so many faces or fewer; all of them where none does."""
        return self._steps.to(target_faces)

    def at(self, step_count: int) -> DecimatedMesh:
        """What ordering would have left after so many collapses and drops.

        The arrays of positions and quadrics are shared by all levels: one level is placed before the next is asked for.
        """
        self._shown[:] = -1
        collapse_count, drop_count = self._steps.counts(step_count)
        drops = self._ordered.drops.head(drop_count)
        log = self.log.head(collapse_count)
        root = log.roots(len(self._ordered.root))
        faces, face_map = faces_left(self._input_faces, self._corner_vertex, log, root, drops)
        shown = []
        for index, nodes in enumerate(self._passes):
            first = int(self._pass_start[index])
            if first < collapse_count:
                wanted = np.isin(self._vertex_of_row[nodes.row], self.log.kept[first:collapse_count])
                shown.append((nodes, wanted))
        self._start_over()
        for nodes, wanted in shown:
            self._show(nodes, wanted)
        if self._present is not None:
            self._show_present(shown, faces, face_map, root)
        at_end = step_count == len(self._steps)
        return replace(
            self._ordered,
            faces=faces,
            face_map=face_map,
            root=root,
            position=self._position,
            quadric=self._quadric,
            stopped=self._ordered.stopped if at_end else "target",
            log=log,
            drops=drops,
        )

    def at_cut(self, cut: Cut) -> DecimatedMesh:
        """The level of a cut, see :mod:`warpqem.decimation.forest_cut`; arrays are shared as with :meth:`at`."""
        last = last_collapses(self.log, cut.kept, len(self._vertex_of_row))
        # What is there already need not be shown; input vertices need no state.
        changed = np.flatnonzero((last != self._shown) & (last >= 0))
        if len(changed):
            self._show_collapses(np.sort(last[changed]))
        self._shown[changed] = last[changed]
        log = self.log.chosen(cut.kept)
        drops = self._ordered.drops
        drops = drops.chosen(cut.dropped, cut.kept) if len(drops) else drops
        root = log.roots(len(self._ordered.root))
        faces, face_map = faces_left(self._input_faces, self._corner_vertex, log, root, drops)
        return replace(
            self._ordered,
            faces=faces,
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
        self._start_over()
        for index, nodes in enumerate(self._passes):
            part = slice(int(self._pass_start[index]), int(self._pass_start[index + 1]))
            parent = np.arange(len(root), dtype=np.int32)
            parent[self.log.removed[part]] = self.log.kept[part]
            root = parent[root]
            place = np.full(len(root), -1, dtype=np.int32)
            kept = np.sort(self.log.kept[part])
            place[kept] = np.arange(len(kept), dtype=np.int32)
            cluster = place[root]
            log = self.log.head(part.stop)
            self._shown[:] = -1
            all_nodes = np.ones(len(kept), dtype=bool)
            self._show(nodes, all_nodes)
            if self._present is not None:
                left = faces_left(self._input_faces, self._corner_vertex, log, root, self._ordered.drops.head(0))
                self._show_present([(nodes, all_nodes)], *left, root)
            inside = np.where(cluster >= 0, root, -1).astype(np.int32)
            ordered = replace(self._ordered, root=inside, position=self._position, quadric=self._quadric, log=log)
            collapse = part.start + np.argsort(self.log.kept[part])
            yield MergedClusters(collapse, kept, cluster, ordered)

    def _start_over(self) -> None:
        """Put every vertex where the input has it, where quadrics are made of the faces around."""
        if self._present is not None:
            row = new_arrays.uploaded(self._ordered.row, dtype=wp.int32, device=self._position.device)
            wp.copy(wp.indexedarray(self._position, [row]), self._ordered.key_position)

    def _show(self, nodes: PassNodes, wanted: np.ndarray) -> None:
        """Put the recorded state of some vertices in place."""
        for array, values in ((self._position, nodes.position), (self._quadric, nodes.quadric)):
            if values is not None:
                put_rows(array, nodes.row[wanted], values[wanted])

    def _show_collapses(self, collapse: np.ndarray) -> None:
        """Put the state after some collapses (n,) in place, all at once: ascending, each of another vertex."""
        ends = np.searchsorted(collapse, self._pass_start)
        row = self._ordered.row[self.log.kept[collapse]]
        parts = [(nodes, slice(a, b)) for nodes, a, b in zip(self._passes, ends[:-1], ends[1:], strict=True) if b > a]
        places = [np.searchsorted(nodes.row, row[part]) for nodes, part in parts]
        for array, name in ((self._position, "position"), (self._quadric, "quadric")):
            values = [getattr(nodes, name).take(place, 0) for (nodes, _), place in zip(parts, places, strict=True)]
            put_rows(array, row, np.concatenate(values))

    def _show_present(
        self, shown: Sequence[tuple[PassNodes, np.ndarray]], faces: np.ndarray, face_map: np.ndarray, root: np.ndarray
    ) -> None:
        """Put the quadrics of the present faces in place, after the positions, for vertices that are left."""
        assert self._present is not None
        left = np.zeros(len(root), dtype=bool)
        left[self._ordered.row[root]] = True
        scale = np.zeros(len(root), dtype=np.float32)
        seen = np.zeros(len(root), dtype=bool)
        added: list[tuple[np.ndarray, np.ndarray]] = []
        # Of a vertex that was merged more than once the last state counts.
        for nodes, wanted in reversed(shown):
            assert nodes.scale is not None
            wanted = wanted & left[nodes.row] & ~seen[nodes.row]
            seen[nodes.row[wanted]] = True
            scale[nodes.row[wanted]] = nodes.scale[wanted]
            for place, values in nodes.added:
                chosen = wanted[place]
                added.append((nodes.row[place[chosen]], values[chosen]))
        row = np.flatnonzero(seen).astype(np.int32)
        self._present.fill(faces, face_map, root, row, scale[row], self._position, self._quadric)
        for row, values in added:
            index = new_arrays.uploaded(row, dtype=wp.int32, device=self._position.device)
            put_rows(self._quadric, row, read_rows(self._quadric, index) + values)


def put_rows(array: wp.array, row: np.ndarray, values: np.ndarray) -> None:
    """Put values into some rows of an array."""
    index = new_arrays.uploaded(row, dtype=wp.int32, device=array.device)
    wp.copy(wp.indexedarray(array, [index]), new_arrays.uploaded(values, dtype=array.dtype, device=array.device))


def copy_rows(source: wp.array, chosen: wp.array, target: wp.array, row: wp.array) -> None:
    """Copy some rows (n,) int32 of an array into some of another one, all on one device."""
    wp.copy(wp.indexedarray(target, [row]), wp.indexedarray(source, [chosen]))
