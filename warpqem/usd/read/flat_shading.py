"""Flat shading: faces with one normal of their own. It stays flat, however small the angles between the faces are.

Normals of such faces are no values of a smooth surface that could be blended: each new face gets its own normal.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from warpqem.mesh.components import lowest_members

__all__ = ["facet_normals", "facet_signs"]

# Unit normals whose coordinates differ by no more than this are one normal: the precision of half floats, and an angle
# of 0.06 degrees.
SAME_NORMAL = 1e-3

# The normal of a flat face is that of its plane within 20 degrees: a folded quadrilateral may have that of either
# triangle. Where several faces share one normal, all lie within 1 degree. What is further off has been bent on purpose.
FACE_COSINE, PLANE_COSINE = float(np.cos(np.radians(20.0))), float(np.cos(np.radians(1.0)))


def facet_signs(
    normals: npt.NDArray[Any],
    corners: npt.NDArray[np.floating],
    edge_corner: npt.NDArray[np.int64],
    polygon: npt.NDArray[np.int32],
) -> npt.NDArray[np.int8]:
    """Find the triangles of flat-shaded faces.

    Args:
        normals: (3N, 3), the normal at each corner of the triangles.
        corners: (N, 3, 3), their points.
        edge_corner: (E, 2, 2), of each edge between two triangles and for each of them the corner (0 to 3N) at each
            end.
        polygon: (N,), the face that each triangle is a part of.

    Returns:
        int8, shape (N,): 1 where a triangle belongs to a flat-shaded face, -1 where its normal points against its
        winding, 0 elsewhere.
    """
    unit = _unit(normals.astype(np.float64)).reshape(-1, 3, 3)
    count = int(polygon.max(initial=-1)) + 1
    first = np.zeros((count, 3))
    first[polygon[::-1]] = unit[::-1, 0]
    constant = np.ones(count, dtype=bool)
    constant[polygon[(np.abs(unit - first[polygon][:, None]) > SAME_NORMAL).any(axis=(1, 2))]] = False
    plane = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).astype(np.float64)
    columns = [np.bincount(polygon, plane[:, axis], count) for axis in range(3)]
    sums = np.asarray(np.stack(columns, axis=1), dtype=np.float64)
    cosine = (_unit(sums) * first).sum(axis=1)
    face = edge_corner[:, :, 0] // 3
    outer = polygon[face[:, 0]] != polygon[face[:, 1]]
    at_ends = unit.reshape(-1, 3)[edge_corner[outer]]
    differs = (np.abs(at_ends[:, 0] - at_ends[:, 1]) > SAME_NORMAL).any(axis=(1, 2))
    pairs = polygon[face[outer]].astype(np.int64)
    # Faces of one plane are one facet, and a facet has a hard edge somewhere.
    facet = lowest_members(count, pairs[constant[pairs].all(axis=1) & ~differs])
    hard = np.zeros(count, dtype=bool)
    hard[facet[pairs[differs]]] = True
    least = np.where(np.bincount(facet, minlength=count)[facet] > 1, PLANE_COSINE, FACE_COSINE)
    bent = np.zeros(count, dtype=bool)
    bent[facet[np.abs(cosine) < least]] = True
    flat = constant & (hard & ~bent)[facet]
    return np.where(flat, np.sign(cosine), 0.0).astype(np.int8)[polygon]


def facet_normals(
    transferred: npt.NDArray[Any],
    points: npt.NDArray[np.floating],
    faces: npt.NDArray[np.int32],
    signs: npt.NDArray[np.int8],
) -> npt.NDArray[np.float64]:
    """Normals (N', ..., 3) at faces or their corners where flat-shaded faces have that of their plane.

    Args:
        carried: (N', ..., 3), what other faces keep, and those without area.
        points: (V', 3).
        faces: int32, shape (N', 3).
        signs: int8, shape (N',), as `facet_signs` gives them for the faces that these go on from.
    """
    corners = points[faces].astype(np.float64)
    plane = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    own = _unit(plane) * signs[:, None]
    shape = (len(faces), *[1] * (transferred.ndim - 2), 3)
    has_own = (own != 0).any(axis=1).reshape((*shape[:-1], 1))
    return np.where(has_own, own.reshape(shape), transferred.astype(np.float64))


def _unit(vectors: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Vectors (..., 3) of length one; those without a length stay nought."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)
