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

    Attributes:
        root: (V,) int32, what each vertex collapsed into at the level asked for last.
        index: (V,) the same as NumPy takes indices, which else makes a copy each time.
    """

    def __init__(self, ordered: DecimatedMesh) -> None:
        self._log, self.root = ordered.log, ordered.root.copy()
        self.index = ordered.root.astype(np.intp)
        self._made = np.ones(len(ordered.log), dtype=bool)
        # What each vertex went into, as far as that collapse is made.
        self._parent = np.arange(len(ordered.root), dtype=np.int32)
        self._parent[ordered.log.removed] = ordered.log.kept

    def at(self, made: npt.NDArray[np.bool_]) -> npt.NDArray[np.integer]:
        """Find the level of some collapses, (C,) bool, with all that they need.

        Returns:
            (n,) int, ascending, the vertices that have another root than in the level before.
        """
        changed = np.flatnonzero(made != self._made)
        if not len(changed):
            return changed
        kept, removed = self._log.kept[changed], self._log.removed[changed]
        # A vertex on the way of which no collapse changed has the root that it had.
        is_open = np.zeros(len(self.root), dtype=bool)
        is_open[self.root[removed]] = True
        self._parent[removed] = np.where(made[changed], kept, removed)
        vertex = np.flatnonzero(is_open.take(self.index))
        end = self._followed(vertex)
        differs = np.flatnonzero(end != self.root.take(vertex))
        vertex, end = vertex.take(differs), end.take(differs)
        self.root[vertex] = self.index[vertex] = end
        self._made = made
        return vertex

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
