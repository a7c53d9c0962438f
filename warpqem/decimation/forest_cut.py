"""Cuts through the forest of collapses: levels that go further in one place than in another.

A collapse merges two clusters of input vertices, so a log of collapses is a forest (Xia & Varshney, "Dynamic view-
dependent simplification for polygonal models", 1996; Hoppe, "View-dependent refinement of progressive meshes", 1997).
A cut keeps some of them, each with all that made its two clusters. The mesh of a cut has the edges that ordering saw
between the same clusters, so its collapses keep the surface as it is, with one exception: where a collapse is left
out, its two ends stay, and both touch its opposite vertices. These must not merge either, or the faces at the edge
between the ends would fold onto each other.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from warpqem.decimation.collapse_log import CollapseRecord
from warpqem.decimation.pruning import DropRecord
from warpqem.runtime.ahead import done_ahead

__all__ = ["CollapseForest", "Cut", "last_collapses"]


def last_collapses(log: CollapseRecord, kept: np.ndarray, vertex_count: int) -> np.ndarray:
    """The last collapse of the cluster that goes by each vertex, of those kept, (C,) bool.

    Returns:
        (V,) int, -1 for a vertex of the input itself, or one that collapsed into another first.
    """
    last = np.full(vertex_count, -1, dtype=np.int64)
    index = np.flatnonzero(kept)
    # Of several the last one counts.
    last[log.kept[index]] = index
    return last


@dataclass(frozen=True)
class Cut:
    """A level between the input and what ordering left.

    Attributes:
        kept: (C,) bool, the collapses that it makes.
        dropped: (D,) bool, the small components that it prunes.
    """

    kept: np.ndarray
    dropped: np.ndarray


class CollapseForest:
    """The collapses of one ordering and what each needs.

    Args:
        log: the collapses.
        drops: the pruned components.
        vertex_count: input vertices.
    """

    def __init__(self, log: CollapseRecord, drops: DropRecord, vertex_count: int) -> None:
        self.log, self.drops, self._vertex_count = log, drops, vertex_count
        self._before_ahead: Callable[[], npt.NDArray[np.int32]] | None = None
        self._ahead: Callable[[], tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]] | None = None
        self._all_removed = int(log.faces_removed.sum())

    def prepare_ahead(self) -> None:
        """Find in threads what cuts without some collapses take, for those who know that they will ask for some."""
        self._before_ahead = done_ahead(lambda: self._preceding)
        self._ahead = done_ahead(lambda: (self._following, self._begun))

    @functools.cached_property
    def last(self) -> npt.NDArray[np.int32]:
        """(V,), the last collapse of all that went by each vertex, -1 for none."""
        last = np.full(self._vertex_count, -1, dtype=np.int32)
        # Of several the last one counts.
        last[self.log.kept] = np.arange(len(self.log), dtype=np.int32)
        return last

    @property
    def _before(self) -> npt.NDArray[np.int32]:
        return self._preceding if self._before_ahead is None else self._before_ahead()

    @functools.cached_property
    def _preceding(self) -> npt.NDArray[np.int32]:
        """(C,), the collapse before each one that went by the same vertex; -1 for none."""
        log, last = self.log, np.full(self._vertex_count, -1, dtype=np.int32)
        before, index = np.empty(len(log), dtype=np.int32), np.arange(len(log), dtype=np.int32)
        ends = [0, *(np.flatnonzero(np.diff(log.round_index)) + 1).tolist(), len(log)]
        # Of one round no two collapses share a vertex.
        for first, end in itertools.pairwise(ends):
            kept = log.kept[first:end]
            before[first:end] = last.take(kept)
            last[kept] = index[first:end]
        return before

    @property
    def _next(self) -> npt.NDArray[np.int32]:
        return self._following if self._ahead is None else self._ahead()[0]

    @property
    def _first(self) -> npt.NDArray[np.int32]:
        return self._begun if self._ahead is None else self._ahead()[1]

    @functools.cached_property
    def _following(self) -> npt.NDArray[np.int32]:
        """(C+1,), the collapse that takes the cluster of each one; C for none, later than all, followed by itself."""
        log, index = self.log, np.arange(len(self.log), dtype=np.int32)
        taken = np.full(self._vertex_count, len(log), dtype=np.int32)
        taken[log.removed] = index
        # A vertex is removed after all collapses that go by it.
        after = np.append(taken.take(log.kept), np.int32(len(log)))
        is_later = self._before >= 0
        after[self._before[is_later]] = index[is_later]
        return after

    @functools.cached_property
    def _begun(self) -> npt.NDArray[np.int32]:
        """(V,), the first collapse of each input vertex; C for none."""
        log, index = self.log, np.arange(len(self.log), dtype=np.int32)
        first = np.full(self._vertex_count, len(log), dtype=np.int32)
        first[log.removed] = index
        # Of several the first one counts.
        first[log.kept[::-1]] = index[::-1]
        return first

    def within(self, error: float) -> Cut:
        """The furthest level whose collapses and drops have no larger error."""
        kept = self.log.error <= error
        return self._closed(kept, self.drops.error <= error, np.flatnonzero(~kept))

    def last_collapses(self, cut: Cut) -> np.ndarray:
        """(V,) int, see :func:`last_collapses`."""
        last = self.last.copy()
        # A cut has what each of its collapses needs: the last ones are those before what it is without.
        vertex = self.log.kept[np.flatnonzero(~cut.kept)]
        found = last[vertex]
        left = np.arange(len(found))
        while len(left):
            at = found[left]
            left = left[(at >= 0) & ~cut.kept[at]]
            found[left] = self._before[found[left]]
        last[vertex] = found
        return last

    def without(self, cut: Cut, collapses: np.ndarray, drops: np.ndarray) -> Cut:
        """A cut without some collapses and drops (indices), and without what needs them."""
        kept, dropped = cut.kept.copy(), cut.dropped.copy()
        left_out = np.unique(collapses)
        kept[left_out], dropped[drops] = False, False
        return self._closed(kept, dropped, left_out)

    def leave_out(self, left_out: npt.NDArray[np.bool_], collapses: np.ndarray) -> None:
        """Add some collapses (indices) to those that are left out, (C,) bool, and all that need them."""
        newest = collapses
        left_out[newest] = True
        while len(newest):
            needing = self._needing(newest)
            newest = needing[~left_out[needing]]
            left_out[newest] = True

    def without_all(self, cut: Cut, left_out: npt.NDArray[np.bool_]) -> Cut:
        """A beginning of the order without what :meth:`leave_out` gave.

        What needs a collapse comes after it, so that nothing else needs what is left out.
        """
        return self._restored(cut.kept & ~left_out, cut.dropped.copy())

    def with_parts(self, collapses: np.ndarray, generations: int) -> np.ndarray:
        """Collapses (indices), and so many generations of those that made their clusters."""
        found = newest = collapses
        for _ in range(generations):
            parts = np.concatenate([self._before[newest], self.last[self.log.removed[newest]]])
            newest = np.unique(parts[parts >= 0])
            found = np.concatenate([found, newest])
        return np.unique(found)

    def faces_removed(self, cut: Cut) -> int:
        """Faces of the input that a cut is without."""
        undone = self.log.faces_removed[np.flatnonzero(~cut.kept)]
        return self._all_removed - int(undone.sum()) + int(self.drops.face_count[cut.dropped].sum())

    def _closed(self, kept: np.ndarray, dropped: np.ndarray, left_out: np.ndarray) -> Cut:
        """The largest cut within a choice of collapses and drops, of which some collapses (indices) are left out."""
        while len(left_out):
            needing = self._needing(left_out)
            left_out = needing[kept[needing]]
            kept[left_out] = False
        return self._restored(kept, dropped)

    def _needing(self, collapses: np.ndarray) -> np.ndarray:
        """The collapses that need some of them at once (indices), each once."""
        needing = np.unique(np.concatenate([self._next[collapses], self._joins_opposites_of(collapses)]))
        return needing[needing < len(self.log)]

    def _restored(self, kept: np.ndarray, dropped: np.ndarray) -> Cut:
        """A cut whose pruned components are those of which no collapse is left out."""
        if len(self.drops):
            # What was pruned was a component as far as its collapses went.
            owner = self.drops.vertex_drop[self.log.kept]
            dropped[owner[~kept & (owner >= 0)]] = False
        return Cut(kept, dropped)

    def _joins_opposites_of(self, collapse: np.ndarray) -> np.ndarray:
        """The collapses that join the two opposite vertices of some of them."""
        opposites = self.log.opposites[collapse]
        opposites = opposites[opposites[:, 1] >= 0]
        # Collapses come after those that they need: from two vertices, the earlier one goes on until both are the
        # collapse that joins them.
        earlier, later = self._first[opposites[:, 0]], self._first[opposites[:, 1]]
        found = []
        while len(earlier):
            earlier, later = np.minimum(earlier, later), np.maximum(earlier, later)
            is_joined = earlier == later
            found.append(later[is_joined])
            earlier, later = self._next[earlier[~is_joined]], later[~is_joined]
        return np.concatenate(found) if found else np.empty(0, dtype=np.int32)
