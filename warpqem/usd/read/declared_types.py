"""The types that attributes of a mesh are declared with: a file may declare the points of a mesh as an integer."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from pxr import Sdf, Usd, UsdGeom

from warpqem.errors import StageError
from warpqem.usd.read.descendants import subsets_of

__all__ = ["check_declared_types"]

# What a mesh is made of. Normals, velocities and extents of another type are named and left out, as a mesh does without
# them; primvars may be of any type.
MESH_ATTRIBUTES = (
    "points", "faceVertexCounts", "faceVertexIndices", "holeIndices", "orientation", "subdivisionScheme",
    "creaseIndices", "creaseLengths", "creaseSharpnesses", "cornerIndices", "cornerSharpnesses",
)  # fmt: skip
SUBSET_ATTRIBUTES = ("indices", "elementType", "familyName")


def check_declared_types(mesh: UsdGeom.Mesh) -> None:
    """Compare the types that attributes of a mesh and its subsets are declared with, with those of their schemas.

    Types of another precision, such as double3[] for point3f[], or of another role fit.

    Raises:
        StageError: one does not fit; the message names prim, attribute and both types.
    """
    for attribute in _attributes(mesh):
        # Of an attribute that a schema knows this is the schema's type, whatever layers say.
        expected = attribute.GetTypeName()
        for spec in attribute.GetPropertyStack():
            declared = spec.typeName
            # Nearly all are; what values have in common takes longer to find.
            if declared != expected and _form(declared) != _form(expected):
                raise StageError(
                    f"{attribute.GetPath()}: declared as {declared} in {spec.layer.identifier}, "
                    f"but the schema says {expected}"
                )


def _attributes(mesh: UsdGeom.Mesh) -> Iterator[Usd.Attribute]:
    prims = [(mesh.GetPrim(), MESH_ATTRIBUTES), *((subset.GetPrim(), SUBSET_ATTRIBUTES) for subset in subsets_of(mesh))]
    for prim, names in prims:
        yield from (attribute for attribute in map(prim.GetAttribute, names) if attribute and attribute.IsAuthored())


def _form(name: Sdf.ValueTypeName) -> tuple[object, ...]:
    """What values of a type have in common with those of another precision: array or not, numbers, components."""
    if name.type.isUnknown:
        # Asking such a type for its scalar type ends the process.
        return (str(name),)
    value = np.asarray(name.scalarType.defaultValue)
    if value.dtype.kind in "OU":
        return name.isArray, str(name.scalarType.type)
    return name.isArray, "i" if value.dtype.kind in "iu" else value.dtype.kind, value.shape
