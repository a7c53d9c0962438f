"""The primvars whose error the collapse order is to keep low."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence

from pxr import Usd, UsdGeom

from warpqem.attributes import MOST_WEIGHT, AttributeField
from warpqem.errors import OptionError, StageError
from warpqem.usd.mesh import MeshSource
from warpqem.usd.seams import corner_values

__all__ = ["AttributeWeights", "check_names", "check_weights", "parse_attribute_weight", "weighted_fields"]

# Weights by primvar name, without "primvars:".
AttributeWeights = Sequence[tuple[str, float]]

# What exporters call texture coordinates that they author as plain pairs of floats.
PAIR_TYPES = ("VtArray<GfVec2h>", "VtArray<GfVec2f>", "VtArray<GfVec2d>")
UV_NAME = re.compile(r"(st|uv|uvmap|uvset|map|texcoord)[_:]?\d*", re.IGNORECASE)


def parse_attribute_weight(text: str) -> tuple[str, float]:
    """Read `NAME=WEIGHT`.

    Raises:
        OptionError: it is something else.
    """
    name, _, weight = text.rpartition("=")
    try:
        if name:
            return _bare(name), float(weight)
    except ValueError:
        pass
    raise OptionError(f"attribute weight '{text}': expected NAME=WEIGHT, such as st=0.1")


def check_weights(uv_weight: float | None, weights: AttributeWeights) -> None:
    """Check that all weights are in range.

    Raises:
        OptionError: one is not.
    """
    for name, weight in (
        ("uv_weight", uv_weight or 0.0),
        *((f"attribute_weights of {name}", w) for name, w in weights),
    ):
        if not (math.isfinite(weight) and 0.0 <= weight <= MOST_WEIGHT):
            raise OptionError(f"{name}: expected a number from 0 to {MOST_WEIGHT:g}, not {weight:g}")


def check_names(prims: Iterable[Usd.Prim], weights: AttributeWeights) -> None:
    """Check that every name is that of a primvar of one of the meshes at least.

    Raises:
        OptionError: one is not.
    """
    prims = list(prims)
    for name, _ in weights:
        if not any(UsdGeom.PrimvarsAPI(prim).GetPrimvar(_bare(name)).HasAuthoredValue() for prim in prims):
            raise OptionError(f"attribute_weights: none of the {len(prims)} meshes has a primvar {_bare(name)}")


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
    named = {_bare(name): weight for name, weight in weights}
    api = UsdGeom.PrimvarsAPI(source.prim)
    wanted = {}
    for primvar in api.GetPrimvarsWithAuthoredValues():
        name = str(primvar.GetPrimvarName())
        weight = named.get(name, uv_weight if _is_uv(primvar) else 0.0)
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
        elif _bare(name) in named:
            raise StageError(f"{source.path}.{name}: has no real numbers at points or corners that could be weighed")
    return fields


def _is_uv(primvar: UsdGeom.Primvar) -> bool:
    kind = primvar.GetTypeName()
    if str(kind.role) == "TextureCoordinate":
        return True
    is_pair = kind.cppTypeName in PAIR_TYPES
    return is_pair and UV_NAME.fullmatch(str(primvar.GetPrimvarName())) is not None


def _bare(name: str) -> str:
    return name.removeprefix("primvars:")
