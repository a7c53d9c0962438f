"""Which primvars of a mesh are texture coordinates."""

from __future__ import annotations

import re

from pxr import UsdGeom

__all__ = ["is_uv"]

# What exporters call texture coordinates that they author as plain pairs of floats.
PAIR_TYPES = ("VtArray<GfVec2h>", "VtArray<GfVec2f>", "VtArray<GfVec2d>")
UV_NAME = re.compile(r"(st|uv|uvmap|uvset|map|texcoord)[_:]?\d*", re.IGNORECASE)


def is_uv(primvar: UsdGeom.Primvar) -> bool:
    """True for texture coordinates, by their type or, for plain pairs of floats, by their name."""
    kind = primvar.GetTypeName()
    if str(kind.role) == "TextureCoordinate":
        return True
    is_pair = kind.cppTypeName in PAIR_TYPES
    return is_pair and UV_NAME.fullmatch(str(primvar.GetPrimvarName())) is not None
