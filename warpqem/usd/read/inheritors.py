"""Meshes that get opinions from other meshes of the same layers, by references, inherits or variants.

Edits of the other mesh are opinions that they get, too. Such a mesh is therefore edited before the other one, so that
its values are read as they were, and what is then edited on the other one alone is hidden on it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from pxr import Sdf, Usd

__all__ = ["heirs_first", "keep_heirs"]


def heirs_first(prims: Sequence[Usd.Prim]) -> list[Usd.Prim]:
    """The same meshes, each before those that it gets opinions from, else in the same order."""
    by_path = {prim.GetPath(): prim for prim in prims}
    # One that gets opinions from another gets those that the other one gets as well, so that it counts more of them.
    count = {path: len(_origins(prim, by_path)) for path, prim in by_path.items()}
    return sorted(prims, key=lambda prim: -count[prim.GetPath()])


def keep_heirs(layer: Sdf.Layer, prims: Iterable[Usd.Prim]) -> None:
    """Hide edits that a mesh gets from another one, where it has no edits of its own.

    Args:
        layer: Edits of the meshes, each at its own path.
        prims: The meshes on the stage of the input.
    """
    by_path = {prim.GetPath(): prim for prim in prims}
    for path, prim in by_path.items():
        for origin in _origins(prim, by_path):
            if layer.GetPrimAtPath(origin):
                _keep(layer, layer.GetPrimAtPath(origin), path, prim)


def _origins(prim: Usd.Prim, meshes: dict[Sdf.Path, Usd.Prim]) -> list[Sdf.Path]:
    layers = prim.GetStage().GetLayerStack()
    paths = {spec.path.StripAllVariantSelections() for spec in prim.GetPrimStack() if spec.layer in layers}
    return sorted(path for path in paths if path != prim.GetPath() and path in meshes)


def _keep(layer: Sdf.Layer, edits: Sdf.PrimSpec, path: Sdf.Path, prim: Usd.Prim) -> None:
    for item in edits.properties:
        if layer.GetPropertyAtPath(path.AppendProperty(item.name)):
            continue
        own = Sdf.CreatePrimInLayer(layer, path)
        if isinstance(item, Sdf.RelationshipSpec):
            targets = prim.GetRelationship(item.name).GetTargets() if prim.HasRelationship(item.name) else []
            Sdf.RelationshipSpec(own, item.name, custom=item.custom).targetPathList.explicitItems = targets
        else:
            _keep_attribute(Sdf.AttributeSpec(own, item.name, item.typeName, item.variability, item.custom), prim)
    for child in edits.nameChildren:
        place = path.AppendChild(child.name)
        original = prim.GetStage().GetPrimAtPath(place)
        if not original:
            continue
        if child.HasActive() and not child.active and original.IsActive():
            own = Sdf.CreatePrimInLayer(layer, place)
            own.active = own.active if own.HasActive() else True
        _keep(layer, child, place, original)


def _keep_attribute(spec: Sdf.AttributeSpec, prim: Usd.Prim) -> None:
    attribute = prim.GetAttribute(spec.name)
    default = attribute.Get() if attribute and attribute.HasAuthoredValue() else None
    times = attribute.GetTimeSamples() if attribute else []
    if default is not None or not times:
        spec.default = Sdf.ValueBlock() if default is None else default
    for time in times:
        value = attribute.Get(time)
        spec.layer.SetTimeSample(spec.path, time, Sdf.ValueBlock() if value is None else value)
    for key in ("interpolation", "elementSize"):
        if attribute and attribute.HasAuthoredMetadata(key):
            spec.SetInfo(key, attribute.GetMetadata(key))
