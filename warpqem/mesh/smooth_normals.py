"""Normals of a smooth surface: means of those of its faces, which hard edges divide."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from warpqem.mesh.components import lowest_members
from warpqem.mesh.directions import unit_vectors
from warpqem.mesh.edges import corner_links, edge_key
from warpqem.mesh.mesh_input import is_proper

__all__ = ["SmoothingGroups", "corner_groups", "vertex_normals"]

# Shorter vectors than this, of sums of unit vectors times angles, have no direction.
SHORTEST = 1e-12


def corner_groups(faces: npt.NDArray[np.int32], hard: npt.NDArray[np.int32]) -> npt.NDArray[np.int64]:
    """Which corners of faces share a normal: those at one vertex that edges join without a hard one between them.

    Args:
        faces: int32, shape (N, 3).
        hard: int32, shape (S, 2), pairs of vertices; those that are no edges say nothing.

    Returns:
        int64, shape (N, 3), numbers from 0 on.
    """
    tail, head = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    count = int(faces.max()) + 1
    key = edge_key(tail, head, count)
    soft = ~np.isin(key, edge_key(hard[:, 0], hard[:, 1], count)) & np.repeat(is_proper(faces), 3)
    _, group = np.unique(lowest_members(faces.size, corner_links(faces, key, soft)), return_inverse=True)
    return group.reshape(faces.shape).astype(np.int64)


class SmoothingGroups:
    """Smooth normals of polygons, hard where the faces of a pose meet at an angle or more.

    Args:
        faces: int32, shape (N, 3).
        degrees: between the normals of two faces. Faces without area meet none at an angle.
    """

    def __init__(self, faces: npt.NDArray[np.int32], degrees: float) -> None:
        tail, head = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
        key = edge_key(tail, head, int(faces.max()) + 1)
        self._faces, self._cosine = faces, float(np.cos(np.radians(degrees)))
        self._links = corner_links(faces, key, np.repeat(is_proper(faces), 3))

    def normals(self, points: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
        """Unit normals (N, 3, 3) at the corners in a pose (V, 3): of each group the mean of its faces, by area."""
        corner = points.astype(np.float64)[self._faces]
        cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        normal, links = unit_vectors(cross), self._links
        # Both ends of an edge have the same faces.
        first, second = (normal[side // 3] for side in links[: len(links) // 2].T)
        cosine = (first * second).sum(axis=1)
        joined = (cosine > self._cosine) | ~(first.any(axis=1) & second.any(axis=1))
        group = lowest_members(self._faces.size, links[np.concatenate([joined, joined])])
        total = [np.bincount(group, np.repeat(axis, 3), self._faces.size) for axis in cross.T]
        return unit_vectors(np.stack(total, axis=1))[group].reshape(corner.shape)


def vertex_normals(points: npt.NDArray[np.float32], faces: npt.NDArray[np.int32]) -> npt.NDArray[np.float32]:
    """Means of the normals of the faces at each vertex, weighted by their angles there (Thuermer and Wuethrich 1998).

    Args:
        points: float32, shape (V, 3).
        faces: int32, shape (N, 3), counter-clockwise seen from the front.

    Returns:
        float32, shape (V, 3), of length one; +z where nothing says which way a vertex faces.
    """
    corners = points[faces].astype(np.float64)
    out, back = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    cross = np.cross(out, back)
    length = np.linalg.norm(cross, axis=2, keepdims=True)
    angle = np.arctan2(length, (out * back).sum(axis=2, keepdims=True))
    # A face without area has an angle somewhere, but no normal.
    weighted = angle * np.divide(cross, length, out=np.zeros_like(cross), where=length > 0)
    sums = [np.bincount(faces.ravel(), weighted[:, :, axis].ravel(), len(points)) for axis in range(3)]
    normals = np.stack(sums, axis=1)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(length > SHORTEST, normals / np.maximum(length, SHORTEST), [0.0, 0.0, 1.0])
    return normals.astype(np.float32)
