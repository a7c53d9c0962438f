"""Keep the feature points of a face through simplification.

The initial quadric of a feature point is equation 1 of "multiresolution facial animation", the face paper:
``e_i = w_i Q(v_i) + sum_j w_j Q(v_j)`` over its neighbours ``v_j``. The neighbours' planes go into the point's own
quadric. The point does not lie on them, so that every collapse there has a cost, and it stays where it is until all
else costs as much.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from warpqem.arguments.array_input import first_outside
from warpqem.arguments.number_input import flag, real_number, shown, whole_number
from warpqem.costs.weights import MAX_WEIGHT
from warpqem.decimation.quadric_sums import QuadricSums
from warpqem.errors import FeaturePointError, OptionError
from warpqem.face.feature_points import FacialFeatures, features_any_way
from warpqem.mesh.edges import edge_table
from warpqem.mesh.mesh_input import MeshInput

__all__ = ["FaceProtection", "face_sums", "protect"]

# At the levels of the paper weights from 10 on keep all points of three faces without the help of ``keep``, and give
# the same levels. Neighbours on finer meshes are nearer to a plane: there 100 keeps all at a tenth of the faces, and 10
# loses a few. Beyond that only ``keep`` does, at no more error than larger weights or rings.
WEIGHT = 100.0


@dataclass(frozen=True)
class FaceProtection:
    """How ``metric="face"`` keeps the feature points of a face.

    Attributes:
        features: the points; None finds them, with +y up and +z out of the face, or else any way round.
        weight: ``w`` of equation 1, of the points and of their neighbours alike, 1 to 1e12.
        ring: neighbours up to so many edges away are summed.
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
        real_number(
            self.weight, "weight of feature points", f"1 to {MAX_WEIGHT:g}", lambda value: 1.0 <= value <= MAX_WEIGHT
        )
        whole_number(self.ring, "ring of feature points", least=0)
        flag(self.keep, "keep")

    def located(self, mesh: MeshInput) -> FaceProtection:
        """The same with its points, found on the mesh where none are given.

        Raises:
            FeaturePointError: no feature point was found.
            OptionError: a feature point is no vertex of the mesh.
        """
        features = self.features
        if features is None:
            features = features_any_way(mesh, "+y", "+z")
        if not features.vertices:
            raise FeaturePointError("metric 'face': no face was found, and no feature points were given")
        outside = first_outside(features.indices, mesh.vertex_count)
        if outside is not None:
            raise OptionError(
                f"metric 'face': the feature point {features.names[outside[0]]} is vertex {features.indices[outside]}, "
                f"but there are {mesh.vertex_count} vertices"
            )
        return replace(self, features=features)


def face_sums(faces: np.ndarray, protection: FaceProtection) -> QuadricSums:
    """Equation 1, as what feature points get on top of their own quadrics, which count once already.

    Args:
        faces: (N, 3) int.
        protection: with features.
    """
    assert protection.features is not None
    edges = edge_table(faces).ends
    tail, head = np.concatenate([edges, edges[:, ::-1]]).T
    head = head[np.argsort(tail, kind="stable")]
    start = np.append(0, np.cumsum(np.bincount(tail)))
    row: list[int] = []
    vertex: list[int] = []
    points = np.unique(protection.features.indices).tolist()
    for point in points:
        reached, newest = {point}, {point}
        for _ in range(int(protection.ring)):
            newest = {near for last in newest for near in head[start[last] : start[last + 1]].tolist()} - reached
            reached |= newest
        row += [point] * len(reached)
        vertex += sorted(reached)
    rows, vertices = np.array(row, dtype=np.int32), np.array(vertex, dtype=np.int32)
    weight = np.where(rows == vertices, protection.weight - 1.0, protection.weight)
    return QuadricSums.of_entries(rows, vertices, weight)


def protect(mesh: MeshInput, protection: FaceProtection) -> tuple[QuadricSums, np.ndarray]:
    """What the quadrics of the feature points get, and which vertices keep their position, (V,) bool.

    Raises:
        FeaturePointError: no feature point was found.
        OptionError: a feature point is no vertex of the mesh, or one without a face.
    """
    located = protection.located(mesh)
    assert located.features is not None
    kept = np.zeros(mesh.vertex_count, dtype=bool)
    kept[located.features.indices] = located.keep
    return face_sums(mesh.faces, located), kept
