"""The files that a layer names beside other layers: value clips, and what attributes of type asset hold (textures).

USD opens value clips while it composes a stage or reads a value, so what could hold it up there is an error before.
Textures are not opened; one that could hold up a program that opens it is noted.
"""

from __future__ import annotations

import glob
import math
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any
from urllib.parse import urlsplit
from urllib.request import url2pathname

from pxr import Ar, Sdf, Tf

from warpqem.errors import StageError
from warpqem.usd.checks.usd_errors import usd_errors_named

__all__ = [
    "ASSET_TYPES",
    "CLIPS",
    "UDIM",
    "NamedAsset",
    "clips_of",
    "evaluated",
    "layers_of",
    "outer_file",
    "place_of",
    "textures_of",
]

ASSET_TYPES = (Sdf.ValueTypeNames.Asset, Sdf.ValueTypeNames.AssetArray)
# Metadata of a prim.
CLIPS = "clips"
# Stands for the number of a tile, 1001 and on.
UDIM = "<UDIM>"
# Clips that a template may stand for: USD looks for each of them. An hour at 24 frames per second is 86400.
MAX_CLIPS = 1_000_000
# Where a time is so many times the step that leads to the next, the sum of both is no later time in double precision.
MAX_STEPS_FROM_ZERO = 1e12


@dataclass(frozen=True)
class NamedAsset:
    """A file that a layer names.

    Attributes:
        owner: Prim or attribute, and for a clip its clip set.
        path: As it is written.
        place: Where it is, also within a package; where it would be, if it is missing.
    """

    owner: str
    path: str
    place: str


def outer_file(place: str) -> str:
    """The file on disk of a path that may lead into a package, or end in arguments for its file format."""
    place = str(Sdf.Layer.SplitIdentifier(place)[0])
    if Ar.IsPackageRelativePath(place) and not os.path.exists(place):
        return str(Ar.SplitPackageRelativePathOuter(place)[0])
    return place


def clips_of(layer: Sdf.Layer, prims: Sequence[Sdf.Path], variables: dict[str, Any]) -> Iterator[NamedAsset]:
    """The value clips, and their manifests, that prims of a layer name.

    Args:
        layer: The layer.
        prims: Prims with clips.

    Raises:
        StageError: a template stands for more clips than can be looked for.
    """
    for path in prims:
        with usd_errors_named(f"{layer.identifier}: {path}", reading=True):
            sets = layer.GetPrimAtPath(path).GetInfo(CLIPS)
        for name, values in sets.items() if isinstance(sets, dict) else ():
            if isinstance(values, dict):
                yield from _clips_of_set(layer, f"{path}, clips {name!r}", values, variables)


def _clips_of_set(
    layer: Sdf.Layer, owner: str, values: dict[str, Any], variables: dict[str, Any]
) -> Iterator[NamedAsset]:
    for key in ("assetPaths", "manifestAssetPath"):
        for asset in _paths_in(values.get(key)):
            yield from _named(layer, owner, asset, variables)
    template = values.get("templateAssetPath")
    if isinstance(template, str) and template:
        times = [values.get(f"template{name}") for name in ("StartTime", "EndTime", "Stride")]
        numbers = [float(time) for time in times if isinstance(time, (int, float))]
        if len(numbers) == len(times):
            _check_times(f"{layer.identifier}: {owner}", *numbers)
        for asset in _files_of_template(layer, evaluated(template, {**layer.expressionVariables, **variables})):
            yield NamedAsset(owner, template, asset)


def _check_times(name: str, start: float, end: float, stride: float) -> None:
    """Refuse a template that USD would look for files of for ever; it reports a stride of 0 or less itself."""
    if stride <= 0:
        return
    steps = (end - start) / stride
    from_zero = max(abs(start), abs(end)) / stride
    if not (math.isfinite(steps) and steps <= MAX_CLIPS and from_zero <= MAX_STEPS_FROM_ZERO):
        raise StageError(
            f"{name}: a template with times from {start:g} to {end:g} every {stride:g} stands for more than "
            f"{MAX_CLIPS} files"
        )


def _files_of_template(layer: Sdf.Layer, template: str) -> list[str]:
    """The files that can stand for a template such as clip.###.usd, whatever the times."""
    path = place_of(layer, template)
    digits = re.compile(re.sub(r"(?:\\#)+", r"-?\\d+", re.escape(path)))
    return [file for file in sorted(glob.glob(re.sub("#+", "*", glob.escape(path)))) if digits.fullmatch(file)]


def textures_of(layer: Sdf.Layer, attributes: Sequence[Sdf.Path], variables: dict[str, Any]) -> Iterator[NamedAsset]:
    """What attributes of type asset name, at all times; each file of a set of UDIM tiles."""
    for path in attributes:
        with usd_errors_named(f"{layer.identifier}: {path}", reading=True):
            values = [layer.GetAttributeAtPath(path).default]
            values += [layer.QueryTimeSample(path, time) for time in layer.ListTimeSamplesForPath(path)]
        for asset in dict.fromkeys(asset for value in values for asset in _paths_in(value)):
            for named in _named(layer, str(path), asset, variables):
                tiles = glob.glob(glob.escape(named.place).replace(UDIM, "[0-9]" * 4)) if UDIM in named.place else []
                yield from (replace(named, place=tile) for tile in sorted(tiles) or [named.place])


def layers_of(layer: Sdf.Layer, variables: dict[str, Any]) -> Iterator[str]:
    """Where the layers are that a layer names, in any variant; not value clips.

    Args:
        layer: The layer.
        variables: Expression variables of the input, which paths may be put together from.
    """
    with usd_errors_named(layer.identifier):
        named = layer.GetCompositionAssetDependencies()
    for asset in named:
        place = place_of(layer, evaluated(asset, {**layer.expressionVariables, **variables}))
        # Where a resolver finds it elsewhere than in a file, this is no path.
        if os.path.isabs(place) or Sdf.Layer.IsAnonymousLayerIdentifier(asset) or Ar.GetResolver().Resolve(place):
            yield place or asset


def _paths_in(value: Any) -> list[str]:
    values = [value] if isinstance(value, Sdf.AssetPath) else value if isinstance(value, Sdf.AssetPathArray) else []
    return [asset.path for asset in values if asset.path]


def _named(layer: Sdf.Layer, owner: str, asset: str, variables: dict[str, Any]) -> Iterator[NamedAsset]:
    place = place_of(layer, evaluated(asset, {**layer.expressionVariables, **variables}))
    if os.path.isabs(place):
        yield NamedAsset(owner, asset, place)


def evaluated(name: str, variables: dict[str, Any]) -> str:
    """A name as it is written, or what it gives as an expression; empty for an expression that gives no text."""
    if not Sdf.VariableExpression.IsExpression(name):
        return name
    value = Sdf.VariableExpression(name).Evaluate(variables).value
    return value if isinstance(value, str) else ""


def place_of(layer: Sdf.Layer, name: str) -> str:
    """Where what a layer names is, or would be: not absolute for a name that is searched for and missing."""
    path = str(Sdf.Layer.SplitIdentifier(name)[0])
    if path.startswith("file:"):
        # USD leaves these to plugins, which may resolve them.
        path = url2pathname(urlsplit(path).path)
    if not path:
        return ""
    try:
        anchored = Sdf.ComputeAssetPathRelativeToLayer(layer, path)
        return str(Ar.GetResolver().Resolve(anchored)) or anchored
    except Tf.ErrorException:
        return ""
