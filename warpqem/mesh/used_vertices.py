"""A first look at faces on a device: which vertices they use, and whether they are fit for what follows."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import warp as wp

from warpqem.kernels.face_check import drop_unfit_faces, mark_used_vertices
from warpqem.runtime import new_arrays
from warpqem.runtime.device import device_traits
from warpqem.runtime.launches import launch
from warpqem.runtime.readback import read_together

__all__ = ["TopologyLook", "used_vertices"]

# Looks at the topology of corners (3N,) int32 of V vertices on a device, -1 in faces to leave out: gives (1,) int32
# there, not zero where something is to be mended.
TopologyLook = Callable[[wp.array, int], wp.array]


def used_vertices(
    faces: np.ndarray, vertex_count: int, device: str, look: TopologyLook | None
) -> tuple[np.ndarray, bool | None] | None:
    """(V,) bool, vertices with a face, and whether a look found the topology clean, None for no look.

    None for faces (N, 3) of which some are unfit, or which are no plain int32.
    """
    if faces.dtype != np.int32 or not faces.flags.c_contiguous or not len(faces):
        return None
    # The vertices, and whether a face is unfit: the host waits once. In whole words.
    marks = new_arrays.zeros(-(-(vertex_count + 1) // 4) * 4, dtype=wp.bool, device=device)
    corner_vertex = new_arrays.uploaded(faces.ravel(), dtype=wp.int32, device=device, copy=False)
    ends = (0, vertex_count), (vertex_count, vertex_count + 1)
    outputs = [new_arrays.part(marks, first, last) for first, last in ends]
    launch(mark_used_vertices, len(faces), [corner_vertex], outputs, device=device)
    looked: list[wp.array] = []
    if look is not None and device_traits(device).own_memory:
        fit = wp.empty_like(corner_vertex)
        launch(drop_unfit_faces, len(faces), [corner_vertex, vertex_count], [fit], device=device)
        looked.append(look(fit, vertex_count))
    found, *unclean = read_together(marks, *looked)
    if found[vertex_count]:
        return None
    return np.array(found[:vertex_count]), not unclean[0][0] if unclean else None
