"""Mean sizes of the faces of an output over the key frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from warpqem.frames.device_frames import to_device
from warpqem.kernels import refit as kernels
from warpqem.runtime import new_arrays
from warpqem.runtime.device import device_traits
from warpqem.runtime.launches import launch
from warpqem.runtime.readback import read_together

__all__ = ["Scales", "frame_scale", "read_scales"]

# They hardly change from frame to frame: about so many frames suffice.
FRAMES = 8
# Sums that a device with its own memory hands to the host, each by a thread.
SUMS = 1024
# A frame is taken for no smaller than this part of the largest one: distances in one that is next to a point say
# nothing of how the others look.
SMALLEST_FRAME = 0.1


@dataclass(frozen=True)
class Scales:
    """Mean sizes over the key frames, in diagonals."""

    area: float
    edge_squared: float

    @classmethod
    def of(cls, points: np.ndarray, faces: np.ndarray) -> Scales:
        """Those of faces (N', 3) in some frames (n, C, 3)."""
        corner = points[:, faces]
        edge = np.roll(corner, -1, axis=2) - corner
        area = 0.5 * np.linalg.norm(np.cross(edge[:, :, 0], edge[:, :, 1]), axis=2).sum(axis=1)
        return cls(float(area.mean()), float((edge.astype(np.float64) ** 2).sum(axis=-1).mean()))


def read_scales(
    points: np.ndarray | wp.array, faces: np.ndarray, corner_vertex: wp.array, other: wp.array
) -> tuple[Scales, np.ndarray]:
    """The scales of faces, and another array of the device, which comes to the host with them.

    Args:
        points: (K, C, 3) float32, or (K, C) points on the device.
        faces: (N', 3) int32.
        corner_vertex: (3N',) int32, the same on the device.
        other: what else is read.
    """
    some, device = points[:: max(1, len(points) // FRAMES)], other.device
    if not device_traits(str(device)).own_memory:
        here = some if isinstance(some, np.ndarray) else some.contiguous().numpy()
        return Scales.of(here, faces), other.numpy()
    # Wherever the frames are: results are the same.
    there = to_device(np.ascontiguousarray(some), str(device)) if isinstance(some, np.ndarray) else some
    sums = new_arrays.empty((min(SUMS, len(faces)), 2), dtype=wp.float64, device=device)
    launch(kernels.sum_face_sizes, len(sums), [there, corner_vertex], [sums], device=device)
    by_thread, with_them = read_together(sums, other)
    area, squared = by_thread.sum(axis=0)
    frame_count = len(some)
    return Scales(float(area) / frame_count, float(squared) / (3 * frame_count * len(faces))), with_them


def frame_scale(points: np.ndarray) -> np.ndarray:
    """(K,) float32, by how much the frames of points (K, n, 3) are smaller than the largest one, by their diagonals.

    Distances of measures are in the diagonal of their frame: a figure that crouches may be half as large.
    """
    diagonal = np.linalg.norm(np.ptp(points, axis=1), axis=1)
    largest = diagonal.max(initial=0.0)
    if not largest > 0.0:
        return np.ones(len(points), dtype=np.float32)
    scale: np.ndarray = (largest / np.maximum(diagonal, SMALLEST_FRAME * largest)).astype(np.float32)
    return scale
