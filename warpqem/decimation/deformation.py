"""What the deformation term keeps: every frame of every vertex, and sums over chunks of frames."""

from __future__ import annotations

import numpy as np
import warp as wp

from warpqem.frames.blocks import chunk_frames
from warpqem.kernels.mesh_state import Deformation
from warpqem.runtime import new_arrays

__all__ = ["build_deformation"]


def build_deformation(
    trajectories: np.ndarray | None, face_count: int, device: str, size: int | None = None
) -> tuple[wp.array, Deformation]:
    """The trajectories (V, F) on the device, and room for what :mod:`warpqem.kernels.deformation` measures.

    Args:
        trajectories: (V, F, 3) float32, in diagonals; None without a deformation term.
        face_count: faces N.
        device: Warp device.
        size: frames in a chunk; None for what suits the device.
    """
    measured = Deformation()
    given = np.empty((0, 0, 3), dtype=np.float32) if trajectories is None else trajectories
    frame_count = given.shape[1]
    measured.chunk_frames = chunk_frames(frame_count, device) if size is None else size
    chunk_count = -(-frame_count // measured.chunk_frames)
    rows = face_count if chunk_count else 0
    measured.face_area = new_arrays.empty((rows, chunk_count), dtype=wp.float32, device=device)
    measured.steps = new_arrays.empty((3 * rows, chunk_count), dtype=wp.vec3, device=device)
    measured.anchor = new_arrays.zeros((len(given), chunk_count), dtype=wp.float32, device=device)
    return new_arrays.uploaded(given, dtype=wp.vec3, device=device, copy=False), measured
