"""Face normals and areas, and area-weighted samples that move with the surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from warpqem.errors import DegenerateMeshError
from warpqem.measure.checked_meshes import CheckedMesh, chosen_frames

__all__ = ["MaterialSamples", "draw_material_samples", "normals_and_areas", "place"]

# Keeps the division by a length of zero defined; far below any length that double precision distinguishes from zero.
TINY = 1e-300


def normals_and_areas(
    points: npt.NDArray[np.float64], faces: npt.NDArray[np.int64]
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Unit normals (N, 3), zero for a face without area, and areas (N,) of one frame (V, 3)."""
    corner = points[faces]
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    length = np.linalg.norm(cross, axis=1)
    return cross / np.maximum(length, TINY)[:, None], length / 2


def place(
    points: npt.NDArray[np.float64],
    faces: npt.NDArray[np.int64],
    face: npt.NDArray[np.integer],
    barycentric: npt.NDArray[np.float64],
) -> npt.NDArray[np.float64]:
    """Positions (S, 3) of material points, given by face (S,) and barycentric coordinates (S, 3), in one frame."""
    corner = faces[face]
    return sum(barycentric[:, k, None] * points[corner[:, k]] for k in range(3))


# Frames, evenly spread, whose mean areas decide where samples lie.
AREA_FRAMES = 8


@dataclass(frozen=True)
class MaterialSamples:
    """Points fixed to the surface: the same face and barycentric coordinates in every frame.

    Attributes:
        face: (S,) int64.
        barycentric: (S, 3) float64.
        mean_area: (S,) float64, area of the sample's face averaged over those frames.
    """

    face: npt.NDArray[np.int64]
    barycentric: npt.NDArray[np.float64]
    mean_area: npt.NDArray[np.float64]

    def weights(self, areas: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Weights (S,), sum 1, that make the samples area-uniform in a frame with the given face areas (N,)."""
        weight = areas[self.face] / self.mean_area
        return weight / weight.sum()


def draw_material_samples(mesh: CheckedMesh, count: int, seed: int, name: str) -> MaterialSamples:
    """Samples drawn in proportion to the face areas averaged over eight frames, in strata of the area.

    Within a face the square-root map of Osada et al., "Shape Distributions" (2002), equation 1, is uniform.

    Raises:
        DegenerateMeshError: all faces have zero area in one of these frames.
    """
    mean_area = np.zeros(len(mesh.faces))
    frames = chosen_frames(AREA_FRAMES, len(mesh.points)).tolist()
    for frame in frames:
        area = normals_and_areas(mesh.points[frame].astype(np.float64), mesh.faces)[1]
        if not area.any():
            raise DegenerateMeshError(f"{name} mesh: every face has zero area in frame {frame}")
        mean_area += area / len(frames)
    random = np.random.default_rng(seed)
    cumulative = np.cumsum(mean_area)
    # A draw that rounding puts at the very end must not fall on a face without area behind the last one with area.
    last = int(np.flatnonzero(mean_area)[-1])
    face = np.searchsorted(cumulative, (np.arange(count) + random.random(count)) / count * cumulative[-1]).clip(0, last)
    root, second = np.sqrt(random.random(count)), random.random(count)
    barycentric = np.stack([1 - root, root * (1 - second), root * second], axis=1)
    return MaterialSamples(face, barycentric, mean_area[face])
