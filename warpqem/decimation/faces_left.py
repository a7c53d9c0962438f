"""The faces that collapses left."""

from __future__ import annotations

import numpy as np
import warp as wp

from warpqem.decimation.collapse_log import CollapseRecord
from warpqem.decimation.pruning import DropRecord
from warpqem.kernels import faces_left as kernels
from warpqem.runtime import new_arrays
from warpqem.runtime.launches import launch

__all__ = ["faces_left"]


def faces_left(
    corner_vertex: wp.array, log: CollapseRecord, root: np.ndarray, drops: DropRecord
) -> tuple[np.ndarray, np.ndarray]:
    """The input's faces that collapses and drops left.

    A collapse takes the faces that hold both its ends: the faces left are those whose corners stayed apart.

    Args:
        corner_vertex: (3N,) int32, the input's faces on the device, one at least.
        log: the collapses.
        root: (V,) int32, the vertex that each input vertex collapsed into.
        drops: the pruned components.

    Returns:
        ``faces`` (N', 3) int32 over the kept vertices, ``face_map`` (N',) int32 ascending, the input face of each.
    """
    device, count = corner_vertex.device, len(corner_vertex) // 3
    roots = new_arrays.uploaded(root, dtype=wp.int32, device=device)
    dropped = new_arrays.uploaded(drops.vertex_drop if len(drops) else [], dtype=wp.int32, device=device)
    before = new_arrays.empty(count, dtype=wp.int32, device=device)
    launch(kernels.mark_faces_left, count, [corner_vertex, roots, dropped], [before], device=device)
    wp.utils.array_scan(before, before, inclusive=True)

    def list_rows(room: int) -> np.ndarray:
        rows = new_arrays.empty(1 + room, dtype=wp.vec4i, device=device)
        launch(kernels.list_faces_left, count, [corner_vertex, roots, before], [rows], device=device)
        return np.array(rows.numpy())

    # As many as the collapses say, so that the host waits once; the device knows the number.
    rows = list_rows(max(0, count - int(log.faces_removed.sum()) - int(drops.face_count.sum())))
    left = int(rows[0, 0])
    if left >= len(rows):
        rows = list_rows(left)
    return np.ascontiguousarray(rows[1 : 1 + left, 1:]), np.array(rows[1 : 1 + left, 0])
