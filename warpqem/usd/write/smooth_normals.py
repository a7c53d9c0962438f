"""Normals for meshes that were smooth because they were subdivided."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom

__all__ = ["NORMAL_ATTRIBUTES", "has_normals", "is_creased", "is_shaded_by_subdivision", "vertex_normals"]

SMOOTH_SCHEMES = (UsdGeom.Tokens.catmullClark, UsdGeom.Tokens.loop)

NORMAL_ATTRIBUTES = ("normals", "primvars:normals", "primvars:normals:indices")

# Shorter vectors than this, of sums of unit vectors times angles, have no direction.
SHORTEST = 1e-12


def is_shaded_by_subdivision(mesh: UsdGeom.Mesh) -> bool:
    """True for a subdivision surface without normals of its own, which looks smooth but at creases.

    Sharp corners say where the surface passes, and are smooth beside the point itself.
    """
    if mesh.GetSubdivisionSchemeAttr().Get() not in SMOOTH_SCHEMES:
        return False
    return not has_normals(mesh.GetPrim())


def has_normals(prim: Usd.Prim) -> bool:
    """True for a mesh with normals of its own."""
    return any(prim.GetAttribute(name).HasAuthoredValue() for name in NORMAL_ATTRIBUTES[:2])


def is_creased(mesh: UsdGeom.Mesh) -> bool:
    """True for a mesh with creases, which has no one normal at each point."""
    return bool(mesh.GetCreaseIndicesAttr().Get(Usd.TimeCode.EarliestTime()))


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
