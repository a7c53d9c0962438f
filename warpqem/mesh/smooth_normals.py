"""Normals of a smooth surface: means of those of its faces, which hard edges divide."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from warpqem.mesh.components import lowest_members
from warpqem.mesh.edges import corner_links, edge_key
from warpqem.mesh.mesh_input import is_proper

__all__ = ["corner_groups", "sharp_edges", "vertex_normals"]

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


def sharp_edges(
    points: npt.NDArray[np.floating], faces: npt.NDArray[np.int32], degrees: float
) -> npt.NDArray[np.int32]:
    """Ends (S, 2) of the edges at which two faces meet at so many degrees or more; faces without area meet at none.

    Args:
        points: (V, 3).
        faces: int32, shape (N, 3).
        degrees: between the normals of the faces.
    """
    corner = points[faces].astype(np.float64)
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
    ends = np.stack([faces.ravel(), np.roll(faces, -1, axis=1).ravel()], axis=1)
    key = edge_key(ends[:, 0], ends[:, 1], int(faces.max()) + 1)
    order = np.argsort(key, kind="stable")
    pair = np.flatnonzero(key[order[1:]] == key[order[:-1]])
    first, second = order[pair], order[pair + 1]
    known = (length[first // 3] > 0)[:, 0] & (length[second // 3] > 0)[:, 0]
    apart = (normal[first // 3] * normal[second // 3]).sum(axis=1) <= np.cos(np.radians(degrees))
    return ends[first[known & apart]].astype(np.int32)


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
