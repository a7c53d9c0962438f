"""Which point of a morphed face belongs to each vertex of another: a projection from the axis of a cylinder.

In coordinates of the cylinder (angle, height, and radius scaled down) the nearest point of the surface is the one on
the same ray from the axis, or beside it where the ray misses. The little that the radius counts tells apart what lies
behind each other, such as ear and cheek. Upper and lower lip lie on each other; each is looked for on its own side of
the line where the lips meet. Where the surfaces fall together already, the nearest point is meant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpqem.face.feature_points import FacialFeatures
from warpqem.measure.closest_points import ClosestPointSearch
from warpqem.mesh.edges import edge_table

__all__ = ["FaceCorrespondence", "LipLine", "correspond", "vertex_normals"]

# The axis of the cylinder is this far behind the tip of the nose, in noses: about the middle of a head.
AXIS_BEHIND = 1.9
# The radius counts this part of angle and height.
RADIUS_SHARE = 0.35
# Triangles that span more than this angle lie at the back, where the cylinder is cut open.
WIDEST_ANGLE = np.pi / 2
# Rounds in which the sides of the lips are averaged over neighbours: a vertex on the line belongs where its faces are.
SIDE_ROUNDS = 2
# A vertex this close to the source lies on it: the nearest point is meant. A lip's own side is left for a point that is
# nearer by this much, as faces of coarse meshes lie across the line. Both in noses.
ON_SURFACE, WRONG_SIDE = 0.04, 0.02
# This far above the line, in noses, what looks straight up still belongs to the upper lip: the line is known to half
# of that.
CERTAIN_HEIGHT = 0.1
# Lips are told apart this far above and below the line, in noses.
LIP_REACH = 0.45


@dataclass(frozen=True)
class FaceCorrespondence:
    """Points on the source for T vertices.

    Attributes:
        vertex: (T, 3) int, corners of the source's face.
        weight: (T, 3) float64, barycentric.
        distance: (T,) float64, how far the morphed point is from the vertex, in noses.
    """

    vertex: np.ndarray
    weight: np.ndarray
    distance: np.ndarray

    def where(self, mask: np.ndarray, other: FaceCorrespondence) -> FaceCorrespondence:
        """The other's points where the mask (T,) holds."""
        return FaceCorrespondence(
            np.where(mask[:, None], other.vertex, self.vertex),
            np.where(mask[:, None], other.weight, self.weight),
            np.where(mask, other.distance, self.distance),
        )

    def blend(self, values: np.ndarray) -> np.ndarray:
        """Values (T, ...) from values at the source's vertices (V, ...)."""
        return np.asarray(np.einsum("tk,tk...->t...", self.weight, values[self.vertex]))


@dataclass(frozen=True)
class LipLine:
    """The line where the lips meet, in noses: a parabola through its ends and its middle.

    Attributes:
        left: left coordinate of the left end.
        right: that of the right end.
        curve: (3,) coefficients of the height over the left coordinate.
    """

    left: float
    right: float
    curve: np.ndarray

    @classmethod
    def of(cls, features: FacialFeatures, local: np.ndarray) -> LipLine | None:
        """The line of a face whose points are ``local`` (V, 3) in noses; None where points of it are missing."""
        names = ("mouth_corner_right", "lip_contact", "mouth_corner_left")
        if not all(name in features.vertices for name in names):
            return None
        place = local[[features.vertices[name] for name in names]]
        if not place[0, 0] < place[1, 0] < place[2, 0]:
            return None
        return cls(float(place[2, 0]), float(place[0, 0]), np.polyfit(place[:, 0], place[:, 1], 2))

    def sides(self, local: np.ndarray, faces: np.ndarray) -> np.ndarray:
        """(V,) int: 1 on the upper lip, -1 on the lower one, 0 elsewhere."""
        height = local[:, 1] - np.polyval(self.curve, local[:, 0])
        # The upper lip looks down onto the lower one, inside the mouth too.
        lean = height / CERTAIN_HEIGHT - vertex_normals(local, faces)[:, 1]
        edges = edge_table(faces).ends
        count = np.bincount(edges.ravel(), minlength=len(local))
        mean = lean
        for _ in range(SIDE_ROUNDS):
            total = np.bincount(edges[:, 0], mean[edges[:, 1]], len(local))
            total += np.bincount(edges[:, 1], mean[edges[:, 0]], len(local))
            mean = (mean + np.divide(total, count, out=mean.copy(), where=count > 0)) / 2
        between = (local[:, 0] > self.right) & (local[:, 0] < self.left) & (np.abs(height) < LIP_REACH)
        return np.where(between, np.where(mean >= 0.0, 1, -1), 0)


def correspond(
    source: np.ndarray,
    source_faces: np.ndarray,
    source_side: np.ndarray,
    target: np.ndarray,
    target_side: np.ndarray,
    device: str,
) -> FaceCorrespondence:
    """Find the point of the source for every vertex of the target, both in noses of the target.

    Args:
        source: (V, 3) morphed points.
        source_faces: (N, 3) int.
        source_side: (V,) lips, see :meth:`LipLine.sides`.
        target: (T, 3) vertices.
        target_side: (T,) lips.
        device: Warp device.
    """

    def search(place: np.ndarray, queries: np.ndarray, faces: np.ndarray, by_side: bool) -> FaceCorrespondence:
        vertex, weight = np.zeros((len(target), 3), dtype=np.int64), np.zeros((len(target), 3))
        corner_side = source_side[faces]
        for side in (0, 1, -1) if by_side else (0,):
            asked = np.flatnonzero(target_side == side) if by_side else np.arange(len(target))
            # The lips are open to what lies around them, but not to each other.
            own = faces if side == 0 else faces[(corner_side != -side).all(axis=1)]
            if len(asked) and len(own):
                found = ClosestPointSearch(own, device, "source").closest(place, queries[asked], 0)
                vertex[asked], weight[asked] = own[found.face], found.barycentric
        at = np.einsum("tk,tkx->tx", weight, source[vertex])
        return FaceCorrespondence(vertex, weight, np.linalg.norm(at - target, axis=1))

    nearest = search(source, target, source_faces, False)
    on_side = search(source, target, source_faces, True)
    unrolled, query = _unroll(source), _unroll(target)
    span = np.ptp(unrolled[source_faces][:, :, 0], axis=1)
    along_ray = search(unrolled, query, source_faces[span < WIDEST_ANGLE * AXIS_BEHIND], True)
    chosen = along_ray.where(nearest.distance < ON_SURFACE, on_side)
    return chosen.where((nearest.distance < ON_SURFACE) & (on_side.distance > nearest.distance + WRONG_SIDE), nearest)


def vertex_normals(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V, 3) unit normals, weighted by area; zero where there is no face."""
    corner = points[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    total = np.stack([np.bincount(faces.ravel(), np.repeat(normal[:, axis], 3), len(points)) for axis in range(3)], 1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.divide(total, length, out=np.zeros_like(total), where=length > 0)


def _unroll(local: np.ndarray) -> np.ndarray:
    """(V, 3) arc on the cylinder, height and share of the radius, of points in noses."""
    forward = local[:, 2] + AXIS_BEHIND
    angle = np.arctan2(local[:, 0], forward)
    return np.stack([angle * AXIS_BEHIND, local[:, 1], RADIUS_SHARE * np.hypot(local[:, 0], forward)], axis=1)
