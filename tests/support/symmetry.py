"""A symmetric mesh."""

import numpy as np

from tests.support.meshes import tube


def symmetric_tube() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A dented tube along x whose halves are triangulated alike, in six poses of which the first is symmetric.

    Also the mirror image of each vertex.
    """
    points, faces = tube(16, 24, radius=0.2)
    points[:, 0] -= 0.5
    points[:, 1:] *= 1 + 0.2 * np.cos(9 * np.abs(points[:, :1]))
    image = np.array([np.linalg.norm(points - point * [-1, 1, 1], axis=1).argmin() for point in points])
    half = faces[points[faces].mean(axis=1)[:, 0] > 0]
    x = points[:, 0]
    bend = [np.stack([0 * x, 0.1 * t * x**2 + 0.05 * t * x, 0 * x], axis=1) for t in range(6)]
    return (points + bend).astype(np.float32), np.concatenate([half, image[half][:, ::-1]]), image


POINTS, FACES, IMAGE = symmetric_tube()
