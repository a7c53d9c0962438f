"""Where a layer names a file: as a sublayer, reference, payload or clip, or as the value of an attribute."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import Any

from pxr import Sdf

__all__ = ["role_of"]

# Suffixes of pictures that shaders read; other files that attributes name are just files.
PICTURES = re.compile(r"\.(bmp|dds|exr|gif|hdr|jpe?g|ktx2?|pic|png|psd|ptx|rat|tex|tga|tiff?|tx|webp)$", re.IGNORECASE)
# Numbers in the name of a clip that a template gives, and of a tile of a texture (some versions of USD list the tiles).
NUMBER = re.compile(r"#+|<UDIM>")
# Metadata that is looked at by other names, or is the value itself.
LOOKED_AT = ("clips", "default", "timeSamples")
# What an asset is called: nothing is read there, and often it is the very place that an output is meant for.
IDENTITY = "assetInfo"


def role_of(layer: Sdf.Layer, name: str) -> str | None:
    """What a file is to the layer that names it, such as "a texture of /Looks/Skin.inputs:file in shot.usda".

    Args:
        layer: The layer.
        name: The file as it is written there, or as USD takes it from an expression or a template.

    Returns:
        The role; None for the name that an asset gives itself, which is not read.
    """
    where = layer.realPath or layer.identifier
    if _is_named(layer.subLayerPaths, name, layer):
        return f"a sublayer of {where}"
    # `Traverse` ends with the last spec, whatever its function returns.
    found: list[str] = []

    def look(path: Sdf.Path) -> None:
        if all(role == IDENTITY for role in found):
            found.extend(_roles(layer, path, name))

    layer.Traverse(Sdf.Path.absoluteRootPath, look)
    roles = [role for role in found if role != IDENTITY]
    if found and not roles:
        return None
    return f"{roles[0] if roles else 'a file that is named'} in {where}"


def _roles(layer: Sdf.Layer, path: Sdf.Path, name: str) -> Iterator[str]:
    spec = layer.GetObjectAtPath(path)
    if isinstance(spec, Sdf.VariantSpec):
        spec = spec.primSpec
    if isinstance(spec, Sdf.AttributeSpec):
        if spec.typeName in (Sdf.ValueTypeNames.Asset, Sdf.ValueTypeNames.AssetArray):
            samples = (layer.QueryTimeSample(path, time) for time in layer.ListTimeSamplesForPath(path))
            if any(_is_named(_strings(value), name, layer) for value in (spec.default, *samples)):
                yield f"{'a texture' if PICTURES.search(name) else 'a file'} of {path}"
    elif isinstance(spec, Sdf.PrimSpec):
        for kind, arcs in (("reference", spec.referenceList), ("payload", spec.payloadList)):
            if _is_named((arc.assetPath for arc in arcs.GetAddedOrExplicitItems()), name, layer):
                yield f"a {kind} of {path}"
        if spec.HasInfo("clips") and _is_named(_strings(spec.GetInfo("clips")), name, layer):
            yield f"a value clip of {path}"
    if isinstance(spec, Sdf.Spec):
        for key in spec.ListInfoKeys():
            if key not in LOOKED_AT and _is_named(_strings(_info(spec, key)), name, layer):
                yield IDENTITY if key == IDENTITY else f"a file that the metadata {key!r} of {path} names"


def _info(spec: Sdf.Spec, key: str) -> Any:
    try:
        return spec.GetInfo(key)
    except TypeError:
        return None  # a type that Python does not know, which is no path


def _strings(value: Any) -> Iterator[str]:
    """All paths and text in a value."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Sdf.AssetPath):
        yield from (value.path, value.evaluatedPath) if hasattr(value, "evaluatedPath") else (value.path,)
    elif isinstance(value, dict):
        for part in value.values():
            yield from _strings(part)
    elif isinstance(value, (list, tuple, Sdf.AssetPathArray)):
        for part in value:
            yield from _strings(part)


def _is_named(texts: Iterable[str], name: str, layer: Sdf.Layer) -> bool:
    return any(_stands_for(text, name, layer) for text in texts)


def _stands_for(text: str, name: str, layer: Sdf.Layer) -> bool:
    """Whether a text in a layer, perhaps a template or an expression, is or gives a name."""
    if text == name:
        return True
    if Sdf.VariableExpression.IsExpression(text):
        return bool(Sdf.VariableExpression(text).Evaluate(layer.expressionVariables).value == name)
    parts = NUMBER.split(text)
    return len(parts) > 1 and re.fullmatch(r"-?\d+".join(map(re.escape, parts)), name) is not None
