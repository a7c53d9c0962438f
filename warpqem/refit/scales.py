"""Mean sizes of the faces of an output over the key frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from warpqem.runtime.readback import read_together

__all__ = ["Scales", "read_some_frames"]

# They hardly change from frame to frame: about so many frames tell enough.
FRAMES = 8


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


def read_some_frames(points: np.ndarray | wp.array, other: wp.array) -> tuple[np.ndarray, np.ndarray]:
    """Some of the frames of points (K, C, 3) or (K, C), and another array of the device with them: both on the host."""
    some = points[:: max(1, len(points) // FRAMES)]
    if isinstance(some, np.ndarray):
        return some, other.numpy()
    frames, with_them = read_together(some.contiguous(), other)
    return frames, with_them
