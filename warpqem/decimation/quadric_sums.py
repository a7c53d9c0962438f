"""Quadrics of other vertices that count at a vertex: sparse rows of weights over the input's vertices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from warpqem.kernels import quadric_sums as kernels
from warpqem.kernels.lanes import width_of
from warpqem.runtime import new_arrays
from warpqem.runtime.launches import launch

__all__ = ["QuadricSums", "add_quadric_sums"]


@dataclass(frozen=True)
class QuadricSums:
    """What the initial quadrics of R vertices get on top of their own: ``Q_i + sum_j w_ij Q_j``, in every frame.

    ``Q_j`` is the quadric of an input vertex with its border and seam planes, times its ``quadric_scale``. Unlike a
    scale, a sum over neighbours holds planes that the vertex does not lie on, so that no collapse there is free.

    Attributes:
        row: (R,) int32 ascending, the vertices ``i``.
        start: (R + 1,) int32, where the entries of each begin.
        vertex: (M,) int32, ``j`` ascending within a row; ``i`` itself is one like any other.
        weight: (M,) float32, ``w_ij``, 0 or more.
    """

    row: np.ndarray
    start: np.ndarray
    vertex: np.ndarray
    weight: np.ndarray

    @classmethod
    def of_entries(cls, row: np.ndarray, vertex: np.ndarray, weight: np.ndarray) -> QuadricSums:
        """Rows from M entries in any order, each pair of vertices once at most."""
        order = np.lexsort((vertex, row))
        own, first = np.unique(row[order], return_index=True)
        start = np.append(first, len(row))
        return cls(
            own.astype(np.int32),
            start.astype(np.int32),
            vertex[order].astype(np.int32),
            weight[order].astype(np.float32),
        )

    @property
    def entry_row(self) -> np.ndarray:
        """(M,) int32, the vertex ``i`` of each entry."""
        return np.repeat(self.row, np.diff(self.start))

    def renumbered(self, place: np.ndarray) -> QuadricSums:
        """The same for vertices that have other numbers, ``place`` (V,)."""
        return QuadricSums.of_entries(place[self.entry_row], place[self.vertex], self.weight)


def add_quadric_sums(sums: QuadricSums, position: wp.array, quadric: wp.array) -> wp.array:
    """Add the sums to quadrics (V, B) about positions (V, B); all are of the quadrics as they were before.

    Returns:
        The sums, (R, B) quadrics about the vertices of the rows.
    """
    device, width = quadric.device, width_of(position)
    row, start, vertex = (wp.array(a, device=device) for a in (sums.row, sums.start, sums.vertex))
    added = new_arrays.empty((len(sums.row), position.shape[1]), dtype=quadric.dtype, device=device)
    launch(
        kernels.gather_sums[width],
        dim=added.shape,
        inputs=[row, start, vertex, wp.array(sums.weight, device=device), position, quadric],
        outputs=[added],
        device=device,
    )
    launch(kernels.add_sums[width], dim=added.shape, inputs=[row, added], outputs=[quadric], device=device)
    return added
