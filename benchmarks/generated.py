"""Meshes of any size that need no file: a bumpy torus that bends and swells."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["MovingTorus", "moving_torus"]

MAJOR, MINOR = 0.4, 0.15
# Squares along the torus for one across: about the ratio of the two circumferences, so that triangles are compact.
ASPECT = MAJOR / MINOR
# Bumps along and across: features that stay the same, whatever the resolution.
BUMPS = (23, 11)
BUMP_HEIGHT = 0.06


class MovingTorus:
    """A closed surface in motion, whose frames are made one by one.

    Frame 0 is the same whatever ``frame_count`` is, and no two frames are congruent.

    Args:
        face_count: about so many triangles.
        frame_count: frames F.

    Attributes:
        faces: (N, 3) int32, counter-clockwise from outside.
        vertex_count: vertices V.
        frame_count: frames F.
    """

    def __init__(self, face_count: int, frame_count: int) -> None:
        across = max(3, round((face_count / (2 * ASPECT)) ** 0.5))
        along = max(3, round(face_count / (2 * across)))
        i, j = np.divmod(np.arange(along * across), across)
        self._u, self._v = 2 * np.pi * i / along, 2 * np.pi * j / across
        self.vertex_count, self.frame_count = along * across, frame_count
        following_i, following_j = (i + 1) % along, (j + 1) % across
        a, b = i * across + j, following_i * across + j
        c, d = following_i * across + following_j, i * across + following_j
        faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
        self.faces: NDArray[np.int32] = faces.astype(np.int32)

    def pose(self, frame: int) -> NDArray[np.float32]:
        """Points of one frame, (V, 3) float32."""
        u, v, phase = self._u, self._v, frame / max(1, self.frame_count)
        wave = np.sin(BUMPS[0] * u + 2 * np.pi * phase) * np.cos(BUMPS[1] * v)
        minor = MINOR * (1 + BUMP_HEIGHT * wave + 0.25 * np.sin(2 * np.pi * phase) * np.cos(2 * u))
        ring = MAJOR + minor * np.cos(v)
        bend = 0.3 * np.sin(np.pi * phase) * np.sin(2 * u)
        points = np.stack([ring * np.cos(u), ring * np.sin(u), minor * np.sin(v) + bend * ring], axis=1)
        return points.astype(np.float32)


def moving_torus(face_count: int, frame_count: int) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Points (F, V, 3) float32 and faces (N, 3) int32 of a :class:`MovingTorus`."""
    torus = MovingTorus(face_count, frame_count)
    return np.stack([torus.pose(frame) for frame in range(frame_count)]), torus.faces
