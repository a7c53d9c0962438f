"""Half-edges of borders and seams, found on the device and listed on the host: most meshes have few."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from warpqem.kernels import constrained_edges as kernels
from warpqem.runtime import new_arrays
from warpqem.runtime.launches import launch

__all__ = ["ConstrainedEdges", "EdgeMarks"]


@dataclass(frozen=True)
class ConstrainedEdges:
    """Half-edges of borders and seams.

    Attributes:
        half_edge: (E,) int32, ascending.
        kind: (E,) int32, 1 at borders and 2 at seams.
        ends: (E, 2) int32, the vertices that each runs from and to.
    """

    half_edge: np.ndarray
    kind: np.ndarray
    ends: np.ndarray

    def of_kind(self, kind: int) -> ConstrainedEdges:
        """Those of one kind."""
        chosen = self.kind == kind
        return ConstrainedEdges(self.half_edge[chosen], self.kind[chosen], self.ends[chosen])

    @property
    def seam_count(self) -> int:
        """Edges of seams, each of which has two half-edges."""
        return int((self.kind == 2).sum()) // 2

    def renumbered(self, half_edge: np.ndarray, vertex: np.ndarray) -> ConstrainedEdges:
        """The same in a mesh with other numbers: ``half_edge`` (E,) of these and ``vertex`` (V,), in no order."""
        return ConstrainedEdges(half_edge, self.kind, vertex[self.ends])

    def marks(self, count: int) -> np.ndarray:
        """(count,) int8, what each half-edge is: 0 for most."""
        marks = np.zeros(count, dtype=np.int8)
        marks[self.half_edge] = self.kind
        return marks

    def lists(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The half-edges by vertex, each at both its ends.

        Returns:
            ``vertex`` (B,), ``start`` (B+1,) and ``half_edge``: those of ``vertex[i]`` are
            ``half_edge[start[i]:start[i + 1]]``, ascending; all int32.
        """
        ends, half_edge = self.ends.T.ravel(), np.concatenate([self.half_edge, self.half_edge])
        order = np.lexsort((half_edge, ends))
        vertex, first = np.unique(ends[order], return_index=True)
        start = np.append(first, len(ends))
        return vertex.astype(np.int32), start.astype(np.int32), half_edge[order].astype(np.int32)


class EdgeMarks:
    """Half-edges of borders and seams as marks on the device.

    Args:
        corner_vertex: (3N,) int32.
        border: (3N,) int32, 1 at half-edges without an opposite one.
        seam: (3N,) int32, 1 at both half-edges of a seam edge.
        count: (1,) int32 on the device: gets the number of half-edges that are marked.
    """

    def __init__(self, corner_vertex: wp.array, border: wp.array, seam: wp.array, count: wp.array) -> None:
        self._corner_vertex, device = corner_vertex, corner_vertex.device
        self._marks, self._before = new_arrays.like(border), new_arrays.like(border)
        launch(kernels.mark_constrained, len(border), [border, seam], [self._marks, self._before], device=device)
        wp.utils.array_scan(self._before, self._before, inclusive=True)
        wp.copy(count, self._before, src_offset=len(border) - 1, count=1)

    def first(self, room: int) -> wp.array:
        """Rows (room,) vec4i of the first half-edges, on the device; where there are fewer, the rest says nothing."""
        device = self._corner_vertex.device
        found = new_arrays.empty(room, dtype=wp.vec4i, device=device)
        inputs = [self._corner_vertex, self._marks, self._before]
        launch(kernels.list_constrained, len(self._marks), inputs, [found], device=device)
        return found

    def listed(self, count: int, known: np.ndarray | None = None) -> ConstrainedEdges:
        """The half-edges; ``count`` is their number, and ``known`` are the first rows, where they came to the host."""
        edges = np.zeros((0, 4), dtype=np.int32) if known is None else known[:count]
        if len(edges) < count:
            edges = np.array(self.first(count).numpy())
        return ConstrainedEdges(edges[:, 0], edges[:, 1], edges[:, 2:])
