"""The roots of levels of one forest, each found from the level before: only in clusters that changed."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import numpy.typing as npt

from warpqem.decimation.decimate import DecimatedMesh
from warpqem.runtime.ahead import done_ahead

__all__ = ["LevelRoots", "RootCounts"]


class LevelRoots:
    """What each input vertex collapsed into at each level, on the host, which knows what decides it.

    Args:
        ordered: the level that the first one is near to, with all collapses of its log.
        counts: what each root stands for, to be kept up; None for nothing.

    Attributes:
        root: (V,) int32, what each vertex collapsed into at the level asked for last.
        index: (V,) the same as NumPy takes indices, which else makes a copy each time.
    """

    def __init__(self, ordered: DecimatedMesh, counts: RootCounts | None = None) -> None:
        self._counts = counts
        self._log, self.root = ordered.log, ordered.root.copy()
        self.index = ordered.root.astype(np.intp)
        self._made = np.ones(len(ordered.log), dtype=bool)
        # What each vertex went into, as far as that collapse is made.
        self._parent = np.arange(len(ordered.root), dtype=np.int32)
        self._parent[ordered.log.removed] = ordered.log.kept

    def at(self, made: npt.NDArray[np.bool_]) -> tuple[npt.NDArray[np.integer], npt.NDArray[np.int32]]:
        """Find the level of some collapses, (C,) bool, with all that they need.

        Returns:
            (n,) int, ascending, the vertices that have another root than in the level before, and that, (n,) int32.
        """
        changed = np.flatnonzero(made != self._made)
        if not len(changed):
            return changed, np.empty(0, dtype=np.int32)
        kept, removed = self._log.kept[changed], self._log.removed[changed]
        # A vertex on the way of which no collapse changed has the root that it had.
        is_open = np.zeros(len(self.root), dtype=bool)
        is_open[self.root[removed]] = True
        self._parent[removed] = np.where(made[changed], kept, removed)
        vertex = np.flatnonzero(is_open.take(self.index))
        end = self._followed(vertex)
        before = self.root.take(vertex)
        differs = np.flatnonzero(end != before)
        vertex, before, end = vertex.take(differs), before.take(differs), end.take(differs)
        if self._counts is not None:
            self._counts.move(vertex, before, end)
        self.root[vertex] = self.index[vertex] = end
        self._made = made
        return vertex, before

    def _followed(self, vertex: npt.NDArray[np.integer]) -> npt.NDArray[np.int32]:
        """(n,) int32, where the ways from some vertices end."""
        end = self._parent[vertex]
        left = np.arange(len(end))
        while len(left):
            before = end[left]
            after = self._parent[before]
            left = left[after != before]
            end[left] = self._parent[end[left]]
        return end


class RootCounts:
    """How many vertices each root stands for, and how many corners of faces these have.

    A thread counts those of the first level; changes are made when somebody asks.

    Args:
        root: (V,) int32, what each vertex collapsed into at first; not to be changed.
        corner_start: gives (V+1,) int32, how many corners come before those of each vertex.
    """

    def __init__(self, root: npt.NDArray[np.int32], corner_start: Callable[[], npt.NDArray[np.int32]]) -> None:
        self._start, self._counted = corner_start, done_ahead(partial(_counted, root, corner_start))
        self._moved: list[tuple[npt.NDArray[np.integer], ...]] = []

    def move(
        self, vertex: npt.NDArray[np.integer], before: npt.NDArray[np.int32], after: npt.NDArray[np.int32]
    ) -> None:
        """Some vertices (n,) have the roots ``after`` (n,) in place of ``before`` (n,)."""
        self._moved.append((vertex, before, after))

    def of(self, kept: npt.NDArray[np.integer]) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
        """The vertices of some roots (n,), (n,) int32, and the corners, (n,) int32."""
        size, corners = self._counted()
        start = self._start()
        for vertex, before, after in self._moved:
            valence = start[1:].take(vertex) - start.take(vertex)
            for root, sign in ((before, -1), (after, 1)):
                # A number of the same type is added ten times as fast.
                np.add.at(size, root, np.int32(sign))
                np.add.at(corners, root, np.int32(sign) * valence)
        self._moved.clear()
        return size.take(kept), corners.take(kept)


def _counted(
    root: npt.NDArray[np.int32], corner_start: Callable[[], npt.NDArray[np.int32]]
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
    """The vertices and the corners of each root, (V,) int32."""
    size, corners = (np.zeros(len(root), dtype=np.int32) for _ in range(2))
    np.add.at(size, root, np.int32(1))
    np.add.at(corners, root, np.diff(corner_start()))
    return size, corners
