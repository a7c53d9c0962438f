"""Every vertex on the way down: what placing needs of the clusters that are merged again later."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from warpqem.kernels.mesh_state import AnyKeyFrames, CollapseLog, MeshState

__all__ = ["NodeRecorder", "PassNodes", "read_rows"]


@dataclass(frozen=True)
class PassNodes:
    """The vertices that one pass merged (n of them): disjoint clusters.

    Attributes:
        row: (n,) int32, ascending: where the vertex that each goes by stands in the arrays of ordering.
        position: (n, B, 3, width) float32, where the pass put it in each block of key frames, in diagonals.
        quadric: (n, B, 10, width) float32, its quadric about that, with the attribute error in the first key frame.
    """

    row: np.ndarray
    position: np.ndarray
    quadric: np.ndarray


class NodeRecorder:
    """Keeps the merged vertices of every pass.

    Attributes:
        passes: one entry for each pass that merged something, in order.
    """

    def __init__(self) -> None:
        self.passes: list[PassNodes] = []

    def record(self, state: MeshState, frames: AnyKeyFrames, log: CollapseLog, begin: int, end: int) -> None:
        """Keep the vertices of the collapses that stand in the log from ``begin`` to ``end``."""
        row = np.sort(log.kept.numpy()[begin:end])
        chosen = wp.array(row, dtype=wp.int32, device=frames.position.device)
        position, quadric = (read_rows(array, chosen) for array in (frames.position, frames.quadric))
        if state.wedges.channel_count > 0:
            # As order_collapses adds it for the vertices that are left at the end.
            attribute = read_rows(state.wedges.quadric, chosen)
            quadric[:, 0, :, 0] += attribute[:, :, 0]
        self.passes.append(PassNodes(row, position, quadric))


def read_rows(array: wp.array, chosen: wp.array) -> np.ndarray:
    """A copy of some rows on the host."""
    rows: np.ndarray = wp.indexedarray(array, [chosen]).contiguous().numpy()
    return rows
