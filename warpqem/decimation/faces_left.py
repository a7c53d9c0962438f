"""The faces that collapses left."""

from __future__ import annotations

import numpy as np
import warp as wp

from warpqem.decimation.collapse_log import CollapseRecord
from warpqem.decimation.pruning import DropRecord
from warpqem.kernels import faces_left as kernels
from warpqem.mesh.indexing import AT_ONCE
from warpqem.runtime import new_arrays
from warpqem.runtime.launches import launch

__all__ = ["MarkedFaces", "faces_left", "numbers_left", "roots_of_faces"]


def faces_left(
    faces: np.ndarray, corner_vertex: wp.array, log: CollapseRecord, root: np.ndarray, drops: DropRecord
) -> tuple[np.ndarray, np.ndarray]:
    """The input's faces that collapses and drops left.

    A collapse takes the faces that hold both its ends: the faces left are those whose corners stayed apart.

    Args:
        faces: (N, 3) int32, the input's, one at least.
        corner_vertex: (3N,) int32, the same on the device.
        log: the collapses.
        root: (V,) int32, the vertex that each input vertex collapsed into.
        drops: the pruned components.

    Returns:
        ``faces`` (N', 3) int32 over the kept vertices, ``face_map`` (N',) int32 ascending, the input face of each.
    """
    face_map = numbers_left(corner_vertex, log, root, drops)
    return roots_of_faces(faces, face_map, root), face_map


def numbers_left(corner_vertex: wp.array, log: CollapseRecord, root: np.ndarray, drops: DropRecord) -> np.ndarray:
    """The ``face_map`` of :func:`faces_left` alone."""
    # As many as the collapses say, so that the host waits once; the device knows the number.
    face_count = len(corner_vertex) // 3
    room = max(0, face_count - int(log.faces_removed.sum()) - int(drops.face_count.sum()))
    roots = new_arrays.uploaded(root, dtype=wp.int32, device=corner_vertex.device)
    marked = MarkedFaces(corner_vertex, roots, drops)
    return marked.listed(np.array(marked.rows(room).numpy()))


def roots_of_faces(faces: np.ndarray, face_map: np.ndarray, root: np.ndarray) -> np.ndarray:
    """(n, 3) int32, what the corners of some faces (n,) int32 collapsed into; see :func:`faces_left`."""
    found = np.empty((len(face_map), 3), dtype=np.int32)
    # Some at a time: new memory for the corners of all takes longer than the rest.
    for first in range(0, len(face_map), AT_ONCE):
        part = slice(first, first + AT_ONCE)
        found[part] = root.take(faces.take(face_map[part], axis=0))
    return found


class MarkedFaces:
    """The faces that are left, on the device.

    Args:
        corner_vertex: (3N,) int32, the input's faces, one at least.
        root: (V,) int32, the vertex that each input vertex collapsed into.
        drops: the pruned components.
    """

    def __init__(self, corner_vertex: wp.array, root: wp.array, drops: DropRecord) -> None:
        device, count = corner_vertex.device, len(corner_vertex) // 3
        dropped = new_arrays.uploaded(drops.vertex_drop if len(drops) else [], dtype=wp.int32, device=device)
        self._before = new_arrays.empty(count, dtype=wp.int32, device=device)
        launch(kernels.mark_faces_left, count, [corner_vertex, root, dropped], [self._before], device=device)
        wp.utils.array_scan(self._before, self._before, inclusive=True)

    def rows(self, room: int) -> wp.array:
        """(1 + room,) int32: how many there are, then as many as there is room for, ascending."""
        device = self._before.device
        rows = new_arrays.empty(1 + room, dtype=wp.int32, device=device)
        launch(kernels.list_faces_left, len(self._before), [self._before], [rows], device=device)
        return rows

    def listed(self, rows: np.ndarray) -> np.ndarray:
        """(N',) int32, the faces, of rows that came to the host; they are fetched where there was no room."""
        left = int(rows[0])
        if left >= len(rows):
            rows = np.array(self.rows(left).numpy())
        return np.array(rows[1 : 1 + left])
