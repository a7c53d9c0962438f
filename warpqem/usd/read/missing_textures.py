"""Textures and other files that the materials and lights of a stage name in vain."""

from __future__ import annotations

import glob
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from pxr import Sdf, Usd, UsdLux, UsdShade

from warpqem.usd.checks.named_assets import ASSET_TYPES, UDIM, outer_file, place_of

__all__ = ["MissingTexture", "missing_lines", "missing_textures"]

# Lines at most; a folder that was left behind takes all of its textures along.
MAX_LINES = 20


@dataclass(frozen=True)
class MissingTexture:
    """A file that cannot be found.

    Attributes:
        attribute: Path of the attribute that names it.
        path: As it is written there.
    """

    attribute: str
    path: str


def missing_textures(stage: Usd.Stage) -> list[MissingTexture]:
    """The files that inputs of shaders, materials and lights name as the stage is composed, and that are not there.

    A set of UDIM tiles is there where one tile is. Each attribute is looked at once, whatever instances it has.
    """
    found: dict[MissingTexture, None] = {}
    seen: set[tuple[str, Sdf.Path]] = set()
    for prim in Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)):
        if not _has_inputs(prim):
            continue
        for attribute in prim.GetAuthoredAttributes():
            if attribute.GetTypeName() not in ASSET_TYPES or not attribute.GetName().startswith("inputs:"):
                continue
            stack = attribute.GetPropertyStack()
            key = (stack[0].layer.identifier, stack[0].path) if stack else ("", attribute.GetPath())
            if key not in seen:
                seen.add(key)
                found |= dict.fromkeys(_missing(attribute, stack))
    return list(found)


def missing_lines(missing: Sequence[MissingTexture]) -> list[str]:
    """A line for each file, with the attributes that name it."""
    owners: dict[str, list[str]] = {}
    for texture in missing:
        owners.setdefault(texture.path, []).append(texture.attribute)
    lines = []
    for path, named in list(owners.items())[:MAX_LINES]:
        more = f" (and for {len(named) - 1} more)" if len(named) > 1 else ""
        lines.append(f"{named[0]}: file {path} cannot be found{more}")
    if len(owners) > MAX_LINES:
        lines.append(f"and {len(owners) - MAX_LINES} more files that materials and lights name cannot be found")
    return lines


def _has_inputs(prim: Usd.Prim) -> bool:
    kinds = (UsdShade.Shader, UsdShade.NodeGraph, UsdLux.LightAPI)
    return any(prim.HasAPI(kind) if kind is UsdLux.LightAPI else prim.IsA(kind) for kind in kinds)


def _missing(attribute: Usd.Attribute, stack: Sequence[Sdf.PropertySpec]) -> Iterator[MissingTexture]:
    """The files of an attribute that are missing, at any time."""
    codes = [Usd.TimeCode(time) for time in attribute.GetTimeSamples()] or [Usd.TimeCode.Default()]
    for code in codes:
        value = attribute.Get(code)
        for asset in [value] if isinstance(value, Sdf.AssetPath) else value or ():
            if asset.path and not asset.resolvedPath and not _has_tile(asset.path, stack):
                yield MissingTexture(str(attribute.GetPath()), asset.path)


def _has_tile(path: str, stack: Sequence[Sdf.PropertySpec]) -> bool:
    """Whether a path stands for a set of tiles, of which one is there, or that is within a package."""
    if UDIM not in path:
        return False
    places = [place_of(spec.layer, path) for spec in stack]
    return any(
        outer_file(place) != place or glob.glob(glob.escape(place).replace(UDIM, "[0-9]" * 4))
        for place in places
        if place
    )
