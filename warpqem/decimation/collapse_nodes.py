"""Every vertex on the way down: what placing needs of the clusters that are merged again later."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from warpqem.kernels.lanes import width_of
from warpqem.kernels.mesh_state import AnyKeyFrames, CollapseLog, MeshState
from warpqem.runtime import new_arrays

__all__ = ["NodeRecorder", "PassNodes", "read_rows"]


@dataclass(frozen=True)
class PassNodes:
    """The vertices that one pass merged (n of them): disjoint clusters.

    Attributes:
        row: (n,) int32, ascending: where the vertex that each goes by stands in the arrays of ordering.
        position: (n, B, 3, width) float32, where the pass put it in each block of key frames, in diagonals.
        quadric: (n, B, 10, width) float32, its quadric about that, with the attribute error in the first key frame;
            None in a memoryless order, where it changes with the faces around.
        scale: (n,) float32, what planes at it count, in a memoryless order.
        added: what such a quadric gets on top of the planes, in order: places in ``row`` and (B, 10, width) for each.
    """

    row: np.ndarray
    position: np.ndarray
    quadric: np.ndarray | None
    scale: np.ndarray | None = None
    added: tuple[tuple[np.ndarray, np.ndarray], ...] = ()

    @property
    def held_bytes(self) -> int:
        """Bytes of its arrays."""
        arrays = [self.row, self.position, self.quadric, self.scale, *(array for pair in self.added for array in pair)]
        return sum(array.nbytes for array in arrays if array is not None)


class NodeRecorder:
    """Keeps the merged vertices of every pass.

    Attributes:
        passes: one entry for each pass that merged something, in order.
        present: quadrics are those of the present faces, to be made anew for each level.
    """

    def __init__(self, as_merged: bool = False) -> None:
        """Begin.

        Args:
            as_merged: In a memoryless order, too, keep quadrics as they are when vertices merge. Levels then have not
                the bits of single results, and vertices no other place where faces around them are others.
        """
        self.passes: list[PassNodes] = []
        self.present, self._as_merged = False, as_merged

    def begin(self, memoryless: bool) -> None:
        """Begin an order."""
        self.present = memoryless and not self._as_merged

    def record(self, state: MeshState, frames: AnyKeyFrames, log: CollapseLog, begin: int, end: int) -> None:
        """Keep the vertices of the collapses that stand in the log from ``begin`` to ``end``."""
        row = np.sort(log.kept[begin:end].numpy())
        chosen = new_arrays.uploaded(row, dtype=wp.int32, device=frames.position.device)
        position = read_rows(frames.position, chosen)
        # As order_collapses adds it for the vertices that are left at the end.
        attribute = read_rows(state.wedges.quadric, chosen)[:, :, 0] if state.wedges.channel_count > 0 else None
        if self.present:
            scale = read_rows(state.quadric_scale, chosen)
            added = self._added(state, frames, chosen, attribute)
            self.passes.append(PassNodes(row, position, None, scale, added))
            return
        quadric = read_rows(frames.quadric, chosen)
        if attribute is not None:
            quadric[:, 0, :, 0] += attribute
        self.passes.append(PassNodes(row, position, quadric))

    @staticmethod
    def _added(
        state: MeshState, frames: AnyKeyFrames, row: wp.array, attribute: np.ndarray | None
    ) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
        added = []
        if state.sum_row is not None and len(state.sum_row) > 0:
            sum_row = read_rows(state.sum_row, row)
            place = np.flatnonzero(sum_row >= 0)
            chosen = new_arrays.uploaded(sum_row[place], dtype=wp.int32, device=frames.position.device)
            added.append((place, read_rows(frames.kept_sum, chosen)))
        if attribute is not None:
            blocks, width = frames.quadric.shape[1], width_of(frames.position)
            values = np.zeros((len(row), blocks, attribute.shape[1], width), dtype=np.float32)
            values[:, 0, :, 0] = attribute
            added.append((np.arange(len(row)), values))
        return tuple(added)


def read_rows(array: wp.array, chosen: wp.array) -> np.ndarray:
    """A copy of some rows on the host."""
    rows: np.ndarray = wp.indexedarray(array, [chosen]).contiguous().numpy()
    return rows
