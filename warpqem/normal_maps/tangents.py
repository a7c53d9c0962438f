"""Tangents at the corners of triangles, in the convention of MikkTSpace, which maps are baked and drawn in.

A renderer has to make the same frames as the program that baked the map (Mikkelsen, Simulation of Wrinkled Surfaces
Revisited, 2008). Corners that agree in position, normal and texture coordinates, and whose texture turns the same way,
share a tangent: the mean of those of their faces, put upright on the normal and weighted by their angles. The bitangent
is the cross product of normal and tangent, turned over where the texture is mirrored.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from warpqem.mesh.directions import unit_vectors

__all__ = ["corner_tangents"]

Floats = npt.NDArray[np.float64]


def corner_tangents(
    corners: npt.NDArray[np.floating], normals: npt.NDArray[np.floating], uvs: npt.NDArray[np.floating]
) -> Floats:
    """Tangents (N, 3, 4) of N triangles: a unit vector, and the side of the bitangent, 1 or -1.

    Args:
        corners: (N, 3, 3) their points.
        normals: (N, 3, 3) unit normals there.
        uvs: (N, 3, 2) texture coordinates there.

    Returns:
        float64. A corner whose faces have no area in the texture, which says no direction, has any one across its
        normal.
    """
    normal, uv = normals.astype(np.float64), np.asarray(uvs, dtype=np.float64)
    along, mirrored = _face_tangents(corners.astype(np.float64), uv)
    # Across each corner's normal, one direction for all faces that share it.
    upright = unit_vectors(along[:, None] - (normal * along[:, None]).sum(axis=2, keepdims=True) * normal)
    weighted = _angles(corners.astype(np.float64), normal)[..., None] * upright
    group = _groups(corners, normals, uv, mirrored).ravel()
    sums = [np.bincount(group, weighted[..., axis].ravel()) for axis in range(3)]
    total: Floats = np.stack(sums, axis=1)
    tangent = unit_vectors(total[group].reshape(normal.shape))
    lost = ~tangent.any(axis=2)
    axis = np.eye(3)[np.abs(normal[lost]).argmin(axis=1)]
    tangent[lost] = unit_vectors(axis - (axis * normal[lost]).sum(axis=1, keepdims=True) * normal[lost])
    side = np.broadcast_to(np.where(mirrored, -1.0, 1.0)[:, None, None], (*tangent.shape[:2], 1))
    return np.concatenate([tangent, side], axis=2)


def _face_tangents(corners: Floats, uvs: Floats) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Where the first texture coordinate grows on each face, (N, 3) of length one or 0, and which are mirrored (N,)."""
    edge, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    first, second = uvs[:, 1] - uvs[:, 0], uvs[:, 2] - uvs[:, 0]
    area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    along = np.sign(area)[:, None] * (edge * second[:, 1:] - other * first[:, 1:])
    return unit_vectors(along), area < 0


def _angles(corners: Floats, normals: Floats) -> Floats:
    """Angles of the faces at their corners, as seen along the normal there: (N, 3)."""
    out, back = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    out, back = (unit_vectors(edge - (edge * normals).sum(axis=2, keepdims=True) * normals) for edge in (out, back))
    angles: Floats = np.arccos(np.clip((out * back).sum(axis=2), -1.0, 1.0))
    return angles


def _groups(
    corners: npt.NDArray[np.floating],
    normals: npt.NDArray[np.floating],
    uvs: Floats,
    mirrored: npt.NDArray[np.bool_],
) -> npt.NDArray[np.int64]:
    """Which corners share a tangent, by number: (N, 3)."""
    side = np.broadcast_to(mirrored[:, None, None], (*corners.shape[:2], 1))
    # Adding 0 makes 0 of -0, which is the same place.
    rows = np.concatenate([corners, normals, uvs, side], axis=2).astype(np.float64) + 0.0
    _, group = np.unique(rows.reshape(-1, rows.shape[2]), axis=0, return_inverse=True)
    numbers: npt.NDArray[np.int64] = group.reshape(corners.shape[:2]).astype(np.int64)
    return numbers
