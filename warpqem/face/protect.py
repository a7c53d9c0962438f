"""Keep the feature points of a face through simplification.

Equation 1 of the source paper weights the quadric of a feature point and those of its neighbours up,
``e_i = w_i Q(v_i) + sum_j w_j Q(v_j)``, so that collapses around it come late. The weights are scales of the vertices'
own quadrics here (Kho & Garland 2003). Late is not never: what must be there in every level keeps its position besides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpqem.array_input import first_outside
from warpqem.errors import FeaturePointError, OptionError
from warpqem.face.features import FacialFeatures, features_of
from warpqem.mesh_input import MeshInput
from warpqem.number_input import flag, real_number, shown, whole_number

__all__ = ["FaceProtection", "face_weights", "protect"]

# The quadric of a feature point counts this often by default. The points are kept in place besides; weights of 100
# alone lose a third of them at half the faces.
WEIGHT = 10.0


@dataclass(frozen=True)
class FaceProtection:
    """How ``metric="face"`` keeps the feature points of a face.

    Attributes:
        features: the points; None finds them, with +y up and +z out of the face, or else any way round.
        weight: factor on the quadrics of feature points, 1 or more.
        ring: neighbours up to so many edges away are weighted too, linearly less the farther they are.
        keep: whether the points stay vertices, with the position they have in every frame.
    """

    features: FacialFeatures | None = None
    weight: float = WEIGHT
    ring: int = 1
    keep: bool = True

    def __post_init__(self) -> None:
        """Refuse weights that would take importance away."""
        if self.features is not None and not isinstance(self.features, FacialFeatures):
            raise OptionError(f"features must be FacialFeatures or None, got {shown(self.features)}")
        real_number(self.weight, "weight of feature points", "1 or more", lambda value: 1.0 <= value < np.inf)
        whole_number(self.ring, "ring of feature points", least=0)
        flag(self.keep, "keep")


def face_weights(faces: np.ndarray, vertex_count: int, protection: FaceProtection) -> np.ndarray:
    """Quadric scales of the vertices, (V,) float32: the weight at feature points, falling to 1 beyond their rings.

    Args:
        faces: (N, 3) int.
        vertex_count: vertices V.
        protection: with features.
    """
    assert protection.features is not None
    ring = int(protection.ring)
    away = np.full(vertex_count, ring + 1)
    away[protection.features.indices] = 0
    sides = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    for step in range(ring):
        nearest = away.copy()
        for a, b in ((0, 1), (1, 0)):
            np.minimum.at(nearest, sides[:, a], np.where(away[sides[:, b]] == step, step + 1, ring + 1))
        away = nearest
    share = 1.0 - away / (ring + 1)
    return (1.0 + (protection.weight - 1.0) * share).astype(np.float32)


def protect(mesh: MeshInput, protection: FaceProtection) -> tuple[np.ndarray, np.ndarray]:
    """Quadric scales (V,) float32, and which vertices keep their position, (V,) bool.

    Raises:
        FeaturePointError: no feature point was found.
        OptionError: a feature point is no vertex of the mesh.
    """
    features = protection.features
    if features is None:
        features = features_of(mesh, "+y", "+z")
        if not features.vertices:
            features = features_of(mesh, None, None)
    if not features.vertices:
        raise FeaturePointError("metric 'face': no face was found, and no feature points were given")
    outside = first_outside(features.indices, mesh.vertex_count)
    if outside is not None:
        raise OptionError(
            f"metric 'face': the feature point {features.names[outside[0]]} is vertex {features.indices[outside]}, "
            f"but there are {mesh.vertex_count} vertices"
        )
    found = FaceProtection(features, protection.weight, protection.ring, protection.keep)
    kept = np.zeros(mesh.vertex_count, dtype=bool)
    kept[features.indices] = protection.keep
    return face_weights(mesh.faces, mesh.vertex_count, found), kept
