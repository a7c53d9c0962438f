"""Meshes of any size that need no file: a bumpy torus that bends and swells."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["moving_torus"]

MAJOR, MINOR = 0.4, 0.15
# Squares along the torus for one across: about the ratio of the two circumferences, so that triangles are compact.
ASPECT = MAJOR / MINOR
# Bumps along and across: features that stay the same, whatever the resolution.
BUMPS = (23, 11)
BUMP_HEIGHT = 0.06


def moving_torus(face_count: int, frame_count: int) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """A closed surface of about ``face_count`` triangles in motion.

    Returns:
        points (F, V, 3) float32 and faces (N, 3) int32, counter-clockwise from outside; frame 0 is the same whatever
        ``frame_count`` is, no two frames are congruent.
    """
    across = max(3, round((face_count / (2 * ASPECT)) ** 0.5))
    along = max(3, round(face_count / (2 * across)))
    i, j = np.divmod(np.arange(along * across), across)
    u, v = 2 * np.pi * i / along, 2 * np.pi * j / across
    points = np.empty((frame_count, along * across, 3), dtype=np.float32)
    for frame in range(frame_count):
        phase = frame / max(1, frame_count)
        wave = np.sin(BUMPS[0] * u + 2 * np.pi * phase) * np.cos(BUMPS[1] * v)
        minor = MINOR * (1 + BUMP_HEIGHT * wave + 0.25 * np.sin(2 * np.pi * phase) * np.cos(2 * u))
        ring = MAJOR + minor * np.cos(v)
        bend = 0.3 * np.sin(np.pi * phase) * np.sin(2 * u)
        points[frame] = np.stack([ring * np.cos(u), ring * np.sin(u), minor * np.sin(v) + bend * ring], axis=1)
    following_i, following_j = (i + 1) % along, (j + 1) % across
    a, b = i * across + j, following_i * across + j
    c, d = following_i * across + following_j, i * across + following_j
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return points, faces.astype(np.int32)
