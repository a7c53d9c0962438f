"""Prims below others, also where a class or an over is above both, which USD's own lists of children leave out."""

from __future__ import annotations

from typing import Any

from pxr import Usd, UsdGeom

__all__ = ["children_of", "like", "subsets_of"]


def children_of(prim: Usd.Prim) -> list[Usd.Prim]:
    """The active children of a prim that are as defined and concrete as it is."""
    children: list[Usd.Prim] = prim.GetFilteredChildren(Usd.TraverseInstanceProxies(like(prim)))
    return children


def subsets_of(mesh: UsdGeom.Mesh) -> list[UsdGeom.Subset]:
    """The GeomSubsets of a mesh; `UsdGeom.Subset.GetAllGeomSubsets` finds none of a mesh below a class."""
    return [UsdGeom.Subset(child) for child in children_of(mesh.GetPrim()) if child.IsA(UsdGeom.Subset)]


def like(prim: Usd.Prim) -> Any:
    """The predicate of active, loaded prims that are as defined and concrete as a prim."""
    # What is below a class is abstract, and what is below an over undefined, whatever it says itself.
    predicate = Usd.PrimIsActive & Usd.PrimIsLoaded
    if prim.IsDefined():
        predicate = predicate & Usd.PrimIsDefined
    return predicate if prim.IsAbstract() else predicate & ~Usd.PrimIsAbstract
