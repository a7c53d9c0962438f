"""What ordering left, brought to the host: the log, and the faces that it says are left."""

from __future__ import annotations

import numpy as np
import warp as wp

from warpqem.decimation.arrangement import Arrangement
from warpqem.decimation.collapse_log import CollapseRecord, log_of, ordered_log
from warpqem.decimation.faces_left import MarkedFaces, faces_left
from warpqem.decimation.pruning import DropRecord
from warpqem.kernels import collapse_order as kernels
from warpqem.runtime import new_arrays
from warpqem.runtime.device import device_traits
from warpqem.runtime.launches import launch
from warpqem.runtime.readback import read_together

__all__ = ["Left"]


class Left:
    """The collapses that ordering made, on the device.

    Args:
        log_rows: the log, see :func:`warpqem.decimation.collapse_log.new_log`.
        count: collapses C in it.
        face_count: faces that are left.
        corner_vertex: (3N,) int32, the input's faces on the device.
        arrangement: what the log's numbers mean; None for those of the input.
    """

    def __init__(
        self,
        log_rows: wp.array,
        count: int,
        face_count: int,
        corner_vertex: wp.array,
        arrangement: Arrangement | None,
    ) -> None:
        self._count, self._face_count = count, face_count
        self._corner_vertex, self._arrangement = corner_vertex, arrangement
        self._log = ordered_log(log_rows, count)

    def read(
        self, vertex_count: int, drops: DropRecord
    ) -> tuple[CollapseRecord, np.ndarray, np.ndarray, np.ndarray]:
        """The log, (V,) int32 the vertex that each one collapsed into, and what :func:`faces_left` gives.

        All is in the input's numbers, as ``drops`` are. The host waits once.
        """
        if not device_traits(str(self._log.device)).own_memory:
            log = self._in_input_terms(self._log.numpy())
            root = log.roots(vertex_count)
            return log, root, *faces_left(self._corner_vertex, log, root, drops)
        marked = MarkedFaces(self._corner_vertex, self._roots(vertex_count), drops)
        ordered, rows = read_together(self._log, marked.rows(self._face_count))
        log = self._in_input_terms(ordered)
        return log, log.roots(vertex_count), *marked.listed(rows)

    def _in_input_terms(self, ordered: np.ndarray) -> CollapseRecord:
        log = log_of(ordered)
        return log if self._arrangement is None else self._arrangement.restore_log(log)

    def _roots(self, vertex_count: int) -> wp.array:
        """(V,) int32 on the device, the vertex that each one of the input collapsed into."""
        device = self._log.device
        parent, root = (new_arrays.empty(vertex_count, dtype=wp.int32, device=device) for _ in range(2))
        vertex = new_arrays.empty(0, dtype=wp.int32, device=device)
        if self._arrangement is not None:
            vertex = self._arrangement.vertex
        launch(kernels.begin_roots, vertex_count, [], [parent], device=device)
        if self._count:
            launch(kernels.link_collapses, self._count, [self._log, vertex], [parent], device=device)
        launch(kernels.follow_collapses, vertex_count, [parent], [root], device=device)
        return root
