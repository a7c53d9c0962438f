"""The faces that collapses left."""

from __future__ import annotations

import numpy as np
import warp as wp

from warpqem.decimation.pruning import DropRecord
from warpqem.kernels import faces_left as kernels
from warpqem.runtime.launches import launch

__all__ = ["faces_left"]


def faces_left(corner_vertex: wp.array, root: np.ndarray, drops: DropRecord) -> tuple[np.ndarray, np.ndarray]:
    """The input's faces that collapses and drops left.

    A collapse takes the faces that hold both its ends: the faces left are those whose corners stayed apart.

    Args:
        corner_vertex: (3N,) int32, the input's faces on the device.
        root: (V,) int32, the vertex that each input vertex collapsed into.
        drops: the pruned components.

    Returns:
        ``faces`` (N', 3) int32 over the kept vertices, ``face_map`` (N',) int32 ascending, the input face of each.
    """
    device, count = corner_vertex.device, len(corner_vertex) // 3
    roots = wp.array(root, dtype=wp.int32, device=device)
    dropped = wp.array(drops.vertex_drop if len(drops) else [], dtype=wp.int32, device=device)
    before = wp.empty(count, dtype=wp.int32, device=device)
    launch(kernels.mark_faces_left, count, [corner_vertex, roots, dropped], [before], device=device)
    wp.utils.array_scan(before, before, inclusive=True)
    face = wp.empty(int(before[count - 1 :].numpy()[0]) if count else 0, dtype=wp.vec4i, device=device)
    if len(face):
        launch(kernels.list_faces_left, count, [corner_vertex, roots, before], [face], device=device)
    rows = face.numpy()
    return np.ascontiguousarray(rows[:, 1:]), np.array(rows[:, 0])
