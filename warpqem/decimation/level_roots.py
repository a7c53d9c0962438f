"""The roots of levels of one forest, each found from the level before: only in clusters that changed."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from warpqem.decimation.decimate import DecimatedMesh

__all__ = ["LevelRoots"]


class LevelRoots:
    """What each input vertex collapsed into at each level, on the host, which knows what decides it.

    Args:
        ordered: the level that the first one is near to, with all collapses of its log.
    """

    def __init__(self, ordered: DecimatedMesh) -> None:
        self._log, self._root = ordered.log, ordered.root
        self._made = np.ones(len(ordered.log), dtype=bool)
        # What each vertex went into, as far as that collapse is made.
        self._parent = np.arange(len(ordered.root), dtype=np.int32)
        self._parent[ordered.log.removed] = ordered.log.kept

    def at(self, made: npt.NDArray[np.bool_]) -> npt.NDArray[np.int32]:
        """(V,) int32, the vertex that each one collapsed into by collapses, (C,) bool, with all that they need."""
        changed = np.flatnonzero(made != self._made)
        if not len(changed):
            return self._root
        kept, removed = self._log.kept[changed], self._log.removed[changed]
        # A vertex on the way of which no collapse changed has the root that it had.
        is_open = np.zeros(len(self._root), dtype=bool)
        is_open[self._root[removed]] = True
        self._parent[removed] = np.where(made[changed], kept, removed)
        vertex = np.flatnonzero(is_open.take(self._root))
        root = self._root.copy()
        root[vertex] = self._followed(vertex)
        self._root, self._made = root, made
        return root

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
