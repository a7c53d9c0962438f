"""What ordering left, brought to the host: the log, and the faces that it says are left."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from warpqem.decimation.arrangement import Arrangement
from warpqem.decimation.collapse_log import CollapseRecord, log_of, ordered_log, read_log
from warpqem.decimation.faces_left import MarkedFaces, numbers_left
from warpqem.decimation.pass_steps import PassSteps
from warpqem.decimation.pruning import DropRecord
from warpqem.kernels import collapse_order as kernels
from warpqem.runtime import new_arrays
from warpqem.runtime.device import device_traits
from warpqem.runtime.launches import launch
from warpqem.runtime.readback import read_together

__all__ = ["OrderReadback"]

# Faces that are left beyond those asked for: room for them costs nothing.
SPARE_ROOM = 16


class OrderReadback:
    """The collapses of an ordering and the faces that they leave.

    Args:
        steps: the passes that make them.
        faces: (N, 3) int32, the input's.
        corner_vertex: (3N,) int32, the same on the device.
        arrangement: what the log's numbers mean; None for those of the input.
    """

    def __init__(
        self, steps: PassSteps, faces: np.ndarray, corner_vertex: wp.array, arrangement: Arrangement | None
    ) -> None:
        self._count, self._rows = steps.log.count, steps.log_rows
        self._face_count, self._corner_vertex = len(faces), corner_vertex
        self._vertex = None if arrangement is None else arrangement.vertex
        self._vertex_count = steps.log_rows.shape[1]
        self._ahead: MarkedFaces | None = None
        self._room = 0

    def ahead(self, target_faces: int, edge_count: int) -> list[wp.array]:
        """All of it on the device, as it comes to the host with the end of an ordering, for :meth:`read`.

        There is room for what collapses leave that reach their target: those inside a surface take two faces each,
        those of the ``edge_count`` edges of borders one.
        """
        excess = max(0, self._face_count - target_faces)
        self._room = min(self._vertex_count, (excess + edge_count) // 2 + SPARE_ROOM)
        log = ordered_log(self._rows, self._count, self._room, self._vertex)
        root = self._roots(log, self._room)
        self._ahead = MarkedFaces(self._corner_vertex, root, DropRecord.none(self._vertex_count))
        return [log, self._ahead.rows(target_faces + SPARE_ROOM)]

    def read(
        self, count: int, face_count: int, drops: DropRecord, brought: Sequence[np.ndarray] = ()
    ) -> tuple[CollapseRecord, np.ndarray, np.ndarray]:
        """The log, (V,) int32 the vertex that each one collapsed into, and (N',) int32 the faces that are left.

        All is in the input's numbers. The host waits once.

        Args:
            count: collapses.
            face_count: faces that are left.
            drops: the pruned components.
            brought: what :meth:`ahead` gave, where it came to the host.
        """
        if self._ahead is not None and brought and count <= self._room:
            marked, (ordered, rows) = self._ahead, brought
        elif device_traits(str(self._rows.device)).own_memory:
            log = ordered_log(self._rows, self._count, count, self._vertex)
            marked = MarkedFaces(self._corner_vertex, self._roots(log, count), drops)
            ordered, rows = read_together(log, marked.rows(face_count))
        else:
            log_here = read_log(self._rows, count, self._vertex)
            root = log_here.roots(self._vertex_count)
            return log_here, root, numbers_left(self._corner_vertex, log_here, root, drops)
        log_here = log_of(ordered, count)
        return log_here, log_here.roots(self._vertex_count), marked.listed(rows)

    def _roots(self, log: wp.array, room: int) -> wp.array:
        """(V,) int32, the vertex that each one collapsed into by a log on the device with room for so many."""
        device, vertex_count = log.device, self._vertex_count
        parent, root = (new_arrays.empty(vertex_count, dtype=wp.int32, device=device) for _ in range(2))
        launch(kernels.begin_roots, vertex_count, [], [parent], device=device)
        if room:
            launch(kernels.link_collapses, room, [log, self._count], [parent], device=device)
        launch(kernels.follow_collapses, vertex_count, [parent], [root], device=device)
        return root
