"""The moving meshes that the tests of the whole simplification share, and what they measure on results."""

import numpy as np

from tests.support import meshes
from warpqem.measure import compare

SPHERE = meshes.swaying_sphere(3, 6)
BAR = meshes.bending_bar(16, 30, 8)
CLOTH = meshes.waving_grid(16, 6)
MESHES = {
    "sphere": SPHERE,
    "bar": BAR,
    "cloth": CLOTH,
    "torus": (meshes.rigid_motion(meshes.torus()[0], 3), meshes.torus()[1]),
}
METRICS = ["qem", "dsd", "dod", "aqem"]


def rms(reference, result, device) -> float:
    """Mean RMS distance in % of the diagonal."""
    points, faces = reference
    points = points[None] if points.ndim == 2 else points
    return compare(points, faces, result.points, result.faces, samples=4000, device=device).rms


def kept_near(result, chosen) -> int:
    """Output vertices whose cluster holds one of the chosen input vertices."""
    return len(np.unique(result.vertex_map[chosen]))
