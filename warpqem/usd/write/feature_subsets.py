"""Feature points of a face on a mesh: point subsets named after them, and primvars."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from pxr import Usd, UsdGeom, Vt

from warpqem.face import FEATURE_NAMES

__all__ = ["FAMILY", "feature_primvars", "feature_subsets", "write_feature_points"]

# Point subsets of this family name feature points: each is named after one and holds it. So do constant primvars in
# this namespace, such as `primvars:face:chin`.
FAMILY = "face"


def feature_primvars(prim: Usd.Prim) -> dict[str, UsdGeom.Primvar]:
    """The primvars of a mesh in the namespace `face` by the rest of their names."""
    found = {}
    for primvar in UsdGeom.PrimvarsAPI(prim).GetPrimvarsWithValues():
        namespace, _, name = str(primvar.GetPrimvarName()).partition(":")
        if namespace == FAMILY and name:
            found[name] = primvar
    return found


def feature_subsets(prim: Usd.Prim) -> dict[str, UsdGeom.Subset]:
    """The point subsets of a mesh of the family `face` by their names."""
    subsets = UsdGeom.Subset.GetGeomSubsets(UsdGeom.Imageable(prim), UsdGeom.Tokens.point, FAMILY)
    return {subset.GetPrim().GetName(): subset for subset in subsets}


def write_feature_points(mesh: UsdGeom.Mesh, points: Mapping[str, int], create: bool) -> None:
    """Give the subsets and primvars that name feature points their points on a new topology.

    Args:
        mesh: The mesh.
        points: New points by name. One that is not among them is gone.
        create: Make a subset for each of them that has none.
    """
    prim = mesh.GetPrim()
    subsets, primvars = feature_subsets(prim), feature_primvars(prim)
    for name in FEATURE_NAMES:
        if name in subsets and name not in points:
            subsets[name].GetPrim().SetActive(False)
        elif name in subsets:
            attribute = subsets[name].GetIndicesAttr()
            attribute.Clear()
            attribute.Set(Vt.IntArray.FromNumpy(np.array([points[name]], dtype=np.int32)))
        elif create and name in points:
            indices = Vt.IntArray.FromNumpy(np.array([points[name]], dtype=np.int32))
            UsdGeom.Subset.CreateGeomSubset(mesh, name, UsdGeom.Tokens.point, indices, FAMILY)
        if name in primvars and name in points:
            primvars[name].GetAttr().Set(points[name])
        elif name in primvars:
            primvars[name].GetAttr().Block()
