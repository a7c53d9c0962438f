"""The primvars whose error the collapse order is to keep low."""

from __future__ import annotations

import re
from collections.abc import Iterable

from pxr import Usd, UsdGeom

from warpqem.attributes import AttributeField
from warpqem.errors import OptionError, StageError
from warpqem.usd.mesh import MeshSource
from warpqem.usd.option_checks import AttributeWeights, bare_name
from warpqem.usd.seams import corner_values

__all__ = ["check_names", "is_uv", "weighted_fields"]

# What exporters call texture coordinates that they author as plain pairs of floats.
PAIR_TYPES = ("VtArray<GfVec2h>", "VtArray<GfVec2f>", "VtArray<GfVec2d>")
UV_NAME = re.compile(r"(st|uv|uvmap|uvset|map|texcoord)[_:]?\d*", re.IGNORECASE)


def check_names(prims: Iterable[Usd.Prim], weights: AttributeWeights) -> None:
    """Check that every name is that of a primvar of one of the meshes at least.

    Raises:
        OptionError: one is not.
    """
    prims = list(prims)
    for name, _ in weights:
        if not any(UsdGeom.PrimvarsAPI(prim).GetPrimvar(bare_name(name)).HasAuthoredValue() for prim in prims):
            raise OptionError(f"attribute_weights: none of the {len(prims)} meshes has a primvar {bare_name(name)}")


def weighted_fields(source: MeshSource, uv_weight: float, weights: AttributeWeights) -> list[AttributeField]:
    """The primvars of a mesh that have a weight, at the corners of its triangles, by their first sample.

    Constant primvars have no error and are left out.

    Args:
        source: The mesh.
        uv_weight: Weight of texture coordinates that `weights` does not name.
        weights: Weights of single primvars.

    Raises:
        StageError: a primvar that `weights` names has no real numbers at points or corners.
    """
    named = {bare_name(name): weight for name, weight in weights}
    api = UsdGeom.PrimvarsAPI(source.prim)
    wanted = {}
    for primvar in api.GetPrimvarsWithAuthoredValues():
        name = str(primvar.GetPrimvarName())
        weight = named.get(name, uv_weight if is_uv(primvar) else 0.0)
        if weight > 0.0 and primvar.GetInterpolation() != UsdGeom.Tokens.constant:
            wanted[primvar.GetAttr().GetName()] = weight
    if not wanted:
        return []
    found = corner_values(source, points_too=True)
    values = {name: next(iter(samples.values())) for name, samples, _ in found if samples}
    fields = []
    for name, weight in wanted.items():
        if name in values and values[name].dtype.kind == "f":
            fields.append(AttributeField(values[name].reshape(len(source.topology.triangles), 3, -1), weight))
        elif bare_name(name) in named:
            raise StageError(f"{source.path}.{name}: has no real numbers at points or corners that could be weighed")
    return fields


def is_uv(primvar: UsdGeom.Primvar) -> bool:
    """True for texture coordinates, by their type or, for plain pairs of floats, by their name."""
    kind = primvar.GetTypeName()
    if str(kind.role) == "TextureCoordinate":
        return True
    is_pair = kind.cppTypeName in PAIR_TYPES
    return is_pair and UV_NAME.fullmatch(str(primvar.GetPrimvarName())) is not None
