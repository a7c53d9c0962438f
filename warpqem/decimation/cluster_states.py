"""Levels of a forest of collapses near what ordering left, without a record of every vertex on the way.

Ordering leaves the state of its last clusters. Those that a level has instead, as collapses were taken back, get theirs
from the input: a vertex in the middle of their input vertices, and the quadric of the faces around it. That says which
input vertices hold the vertex when it is placed; the place itself comes from the planes of the input.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from warpqem.decimation.collapse_nodes import read_rows
from warpqem.decimation.decimate import DecimatedMesh
from warpqem.decimation.forest_cut import CollapseForest, Cut
from warpqem.decimation.level_faces import LevelFaces
from warpqem.decimation.level_roots import LevelRoots, RootCounts
from warpqem.decimation.memoryless_quadrics import MemorylessQuadrics
from warpqem.decimation.pruning import DropRecord
from warpqem.decimation.replay import copy_rows, put_rows
from warpqem.kernels import anchor as kernels
from warpqem.kernels.lanes import width_of
from warpqem.runtime import new_arrays
from warpqem.runtime.ahead import done_ahead
from warpqem.runtime.device import device_traits
from warpqem.runtime.launches import launch

__all__ = ["ClusterLevel", "ClusterStates"]

# In place of a collapse, the last one of a cluster.
NO_STATE = -2


@dataclass(frozen=True)
class ClusterLevel:
    """A level, and what its clusters are.

    Attributes:
        ordered: the level; the arrays of roots, positions and quadrics are shared by all of them.
        last: (V,) int32, the last collapse of each cluster, see :meth:`CollapseForest.last_collapses`.
        is_kept: (V,) bool, its vertices.
        root_index: (V,) its roots as NumPy takes indices; shared likewise.
        root_there: (V,) int32, the same on a device with memory of its own; else None.
    """

    ordered: DecimatedMesh
    last: np.ndarray
    is_kept: np.ndarray
    root_index: np.ndarray
    root_there: wp.array | None


@dataclass(frozen=True)
class _Topology:
    """What the host finds of a level, beside its roots; see :class:`ClusterLevel`."""

    faces: np.ndarray
    face_map: np.ndarray
    drops: DropRecord
    last: np.ndarray
    is_kept: np.ndarray


class ClusterStates:
    """All that placing needs of any level of a forest.

    Args:
        input_faces: (N, 3) int32, what was ordered.
        ordered: what that left.
        forest: its collapses.
        faces_at: finds faces of the input at some of its vertices, see :class:`LevelFaces`.
        counts: what each root of a level stands for, to be kept up; None for nothing.
    """

    def __init__(
        self,
        input_faces: np.ndarray,
        ordered: DecimatedMesh,
        forest: CollapseForest,
        faces_at: Callable[[np.ndarray], np.ndarray],
        counts: RootCounts | None = None,
    ) -> None:
        self._input_faces, self._faces_at, self._counts = input_faces, faces_at, counts
        self._ordered, self._forest = ordered, forest
        self._ahead: tuple[Cut, Callable[[], _Topology]] | None = None
        # The last collapse of the cluster whose state each vertex shows, (V,) int32, from the first level on.
        self._shown: np.ndarray | None = None
        # Before what the host has to do: so the device has no wait for it.
        self._position, self._quadric = wp.clone(ordered.position), wp.clone(ordered.quadric)
        self._present = MemorylessQuadrics(input_faces, ordered)

    @functools.cached_property
    def _left(self) -> np.ndarray:
        """(V,) int32, the last collapse of each cluster that ordering left; of others, and pruned ones, no state."""
        root, last = self._ordered.root, self._forest.last
        is_left = root == np.arange(len(last), dtype=root.dtype)
        is_left &= self._ordered.drops.vertex_drop < 0
        return np.where(is_left, last, np.int32(NO_STATE))

    @functools.cached_property
    def _roots(self) -> LevelRoots:
        return LevelRoots(self._ordered, self._counts)

    @functools.cached_property
    def _faces(self) -> LevelFaces:
        return LevelFaces(self._input_faces, self._faces_at, self._ordered)

    def find_ahead(self, cut: Cut) -> None:
        """Find in a thread what the first level is, for those who know it."""

        def find() -> _Topology:
            # Asked for with the level.
            _ = self._left
            return self._found(cut, self._roots.at(cut.kept))

        self._ahead = cut, done_ahead(find)

    def at(self, cut: Cut, known: ClusterLevel | None = None) -> ClusterLevel:
        """A level, for as long as no other one is asked for.

        ``known`` is what was given for the same cut before, and says that no other level will be asked for.
        """
        ordered, found = self._ordered, None
        if self._ahead is not None:
            begun, result = self._ahead
            found = result()
            self._ahead = None
            found = found if begun is cut else None
        changed_roots = self._roots.at(cut.kept) if found is None else None
        root, device, root_there = self._roots.root, ordered.position.device, None
        if device_traits(str(device)).own_memory:
            # As soon as it is known: the host has more to do.
            root_there = new_arrays.uploaded(root, dtype=wp.int32, device=device)
        if known is not None:
            level = known.ordered
            found = _Topology(level.faces, level.face_map, level.drops, known.last, known.is_kept)
        elif found is None:
            assert changed_roots is not None
            found = self._found(cut, changed_roots)
        faces, face_map, last, is_kept = found.faces, found.face_map, found.last, found.is_kept
        if self._shown is None:
            # An input vertex has no recorded state, but a place.
            self._put_input(np.flatnonzero(self._left == -1))
            self._shown = self._left.copy()
        changed = np.flatnonzero(is_kept & (last != self._shown))
        self._shown[changed] = last[changed]
        self._restore(changed[last[changed] == self._left[changed]])
        self._make(changed[last[changed] != self._left[changed]], faces, face_map, root)
        level = replace(
            ordered,
            faces=faces,
            face_map=face_map,
            root=root,
            position=self._position,
            quadric=self._quadric,
            stopped="target",
            log=ordered.log.chosen_later(cut.kept),
            drops=found.drops,
        )
        return ClusterLevel(level, last, is_kept, self._roots.index, root_there)

    def _found(self, cut: Cut, changed: tuple[np.ndarray, np.ndarray]) -> _Topology:
        """What the host finds of a level, of which some vertices had other roots in the one before."""
        drops = self._ordered.drops
        drops = drops.chosen(cut.dropped, cut.kept) if len(drops) else drops
        faces, face_map = self._faces.at(self._roots.root, *changed, drops)
        return _Topology(faces, face_map, drops, self._forest.last_collapses(cut), self._faces.is_kept)

    def move(self, vertex: np.ndarray, position: wp.array, level: DecimatedMesh) -> None:
        """Put some kept vertices (n,) of a level elsewhere, (n, B) points, with the quadrics of the faces there."""
        device = self._position.device
        every, row = (
            wp.array(a, dtype=wp.int32, device=device) for a in (np.arange(len(vertex)), self._ordered.row[vertex])
        )
        copy_rows(position, every, self._position, row)
        self._renew(vertex, level.faces, level.face_map, level.root)

    def made(self, vertex: np.ndarray) -> np.ndarray:
        """Those of some kept vertices whose state is none that ordering left; not those of one input vertex."""
        assert self._shown is not None, "a level was asked for"
        shown = self._shown[vertex]
        own: np.ndarray = vertex[(shown != self._left[vertex]) & (shown >= 0)]
        return own

    def _restore(self, vertex: np.ndarray) -> None:
        """Put the state that ordering left back."""
        row = wp.array(self._ordered.row[vertex], dtype=wp.int32, device=self._position.device)
        copy_rows(self._ordered.position, row, self._position, row)
        copy_rows(self._ordered.quadric, row, self._quadric, row)

    def _put_input(self, vertex: np.ndarray) -> None:
        """Put input vertices (n,) where they are."""
        device = self._position.device
        index, row = (wp.array(a, dtype=wp.int32, device=device) for a in (vertex, self._ordered.row[vertex]))
        copy_rows(self._ordered.key_position, index, self._position, row)

    def _make(self, vertex: np.ndarray, faces: np.ndarray, face_map: np.ndarray, root: np.ndarray) -> None:
        """Put some vertices in the middle of their clusters."""
        if not len(vertex):
            return
        place = np.full(len(root), -1, dtype=np.int32)
        place[vertex] = np.arange(len(vertex), dtype=np.int32)
        cluster = place.take(self._roots.index)
        member = np.flatnonzero(cluster >= 0)
        # By cluster, then by vertex: as no two keys are equal, they need no stable sort, which takes longer.
        key = cluster[member].astype(np.int64) << 32 | member
        key.sort()
        first = np.flatnonzero(np.diff(key >> 32, prepend=-1))
        member = key & 0xFFFFFFFF
        self._put_in_the_middle(self._ordered.row[vertex], first, member.astype(np.int32))
        self._renew(vertex, faces, face_map, root)

    def _put_in_the_middle(self, row: np.ndarray, first: np.ndarray, member: np.ndarray) -> None:
        """Put the vertices of some rows (n,) in the middle of their members, each of which begin at ``first`` (n,)."""
        position, points = self._position, self._ordered.key_position
        device = position.device
        index, start = new_arrays.uploaded(member, dtype=wp.int32, device=device), np.append(first, len(member))
        if device_traits(str(device)).own_memory:
            rows, starts = (new_arrays.uploaded(values, dtype=wp.int32, device=device) for values in (row, start))
            inputs = [rows, starts, index, points]
            kernel = kernels.put_in_the_middle[width_of(points)]
            launch(kernel, (len(row), points.shape[1]), inputs, [position], device=device)
            return
        count = np.diff(start).astype(np.float32)
        middle = np.add.reduceat(read_rows(points, index), first, axis=0) / count[:, None, None, None]
        put_rows(position, row, middle)

    def _renew(self, vertex: np.ndarray, faces: np.ndarray, face_map: np.ndarray, root: np.ndarray) -> None:
        """Make the quadrics of some vertices those of the faces around them."""
        row = self._ordered.row[vertex].astype(np.int32)
        # What planes count does not matter to the weights that hold a vertex.
        scale = np.ones(len(row), dtype=np.float32)
        self._present.fill(faces, face_map, root, row, scale, self._position, self._quadric)
