"""A small mesh whose frames come and go in blocks."""

from __future__ import annotations

import numpy as np

from tests.support import meshes

FRAME_COUNT = 21


def noisy_sphere(subdivisions: int = 2, frames: int = FRAME_COUNT) -> tuple[np.ndarray, np.ndarray]:
    """Float64 points whose every frame is a shape of its own."""
    points, faces = meshes.swaying_sphere(subdivisions, frames)
    return points + 0.02 * np.random.default_rng(0).random(points.shape), faces


POINTS, FACES = noisy_sphere()
