"""Edits of meshes brought into a layer that somebody else has, such as a layer of an open stage."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pxr import Sdf, Usd

from warpqem.errors import OptionError, StageError
from warpqem.usd.checks.usd_errors import usd_errors_named

__all__ = ["check_output_layer", "merge_edits"]

# Fields that hold other specs, and values, which are brought over as a whole.
SPECS = frozenset({"primChildren", "properties", "variantSetChildren", "variantChildren", "targetChildren"})
# Lists of paths are read as values and written as lists only.
PATH_LISTS = {"targetPaths": "targetPathList", "connectionPaths": "connectionPathList"}
NOT_COPIED = SPECS | {"connectionChildren", "default", "timeSamples", *PATH_LISTS}

Time = Callable[[float], float]


def check_output_layer(layer: Sdf.Layer, stage: Usd.Stage) -> None:
    """Check, before the work, that edits can be made in a layer.

    Args:
        layer: A layer of the stage's own stack, where the edits show, or one that the stage does not use.
        stage: The input.

    Raises:
        OptionError: it cannot be edited, or the stage uses it by a reference, so that paths are others there.
    """
    if not layer.permissionToEdit:
        raise OptionError(f"output {layer.identifier}: the layer must not be edited (permissionToEdit)")
    if layer in stage.GetUsedLayers() and layer not in stage.GetLayerStack():
        raise OptionError(
            f"output {layer.identifier}: the stage has this layer by a reference, payload or clip, not as one of its "
            f"own layers, so that paths are others there"
        )


def merge_edits(edits: Sdf.Layer, layer: Sdf.Layer, stage: Usd.Stage) -> None:
    """Bring edits into a layer; whatever else it holds stays.

    Args:
        edits: Edits of meshes of the stage, at times of the stage.
        layer: A layer that `check_output_layer` has passed.
        stage: The input.

    Raises:
        StageError: a stronger layer of the stage would hide an edit, or USD cannot make one; the layer stays as it is
            then.
    """
    paths: list[Sdf.Path] = []
    edits.Traverse(Sdf.Path.absoluteRootPath, paths.append)
    paths.sort()
    if layer in stage.GetLayerStack():
        _check_stronger(paths, edits, layer, stage)
        to_stage = stage.GetEditTargetForLocalLayer(layer).GetMapFunction().timeOffset
        to_layer: Time = to_stage.GetInverse().__mul__
    else:
        if layer.empty:
            layer.timeCodesPerSecond = stage.GetTimeCodesPerSecond()
        rate = layer.timeCodesPerSecond / stage.GetTimeCodesPerSecond()
        to_layer = rate.__mul__
    before = Sdf.Layer.CreateAnonymous()
    before.TransferContent(layer)
    try:
        with usd_errors_named(layer.identifier), Sdf.ChangeBlock():
            for path in paths:
                _merge(edits, layer, path, to_layer)
    except BaseException:
        layer.TransferContent(before)
        raise


def _check_stronger(paths: list[Sdf.Path], edits: Sdf.Layer, layer: Sdf.Layer, stage: Usd.Stage) -> None:
    layers = stage.GetLayerStack()
    for path in paths:
        for stronger in layers[: layers.index(layer)]:
            spec = stronger.GetPropertyAtPath(path) if path.IsPropertyPath() else None
            if spec and _has_value(spec):
                raise StageError(
                    f"{path}: the edit would be hidden in {layer.identifier}, as the stronger layer "
                    f"{stronger.identifier} has a value; give that layer as the output, or one above it"
                )


def _has_value(spec: Sdf.PropertySpec) -> bool:
    return any(spec.HasInfo(key) for key in ("default", "timeSamples", "targetPaths"))


def _merge(edits: Sdf.Layer, layer: Sdf.Layer, path: Sdf.Path, to_layer: Time) -> None:
    source = edits.GetObjectAtPath(path)
    if path == Sdf.Path.absoluteRootPath or not isinstance(source, (Sdf.PrimSpec, Sdf.PropertySpec)):
        return
    target, skipped = layer.GetObjectAtPath(path), NOT_COPIED
    if target is None:
        target = _create(layer, source)
    else:
        # What is there already keeps what it is.
        skipped = skipped | {"specifier", "typeName", "custom", "variability"}
    for key in sorted(source.ListInfoKeys()):
        if key not in skipped:
            target.SetInfo(key, _combined(source.GetInfo(key), target.GetInfo(key) if target.HasInfo(key) else None))
    for key, name in PATH_LISTS.items():
        if source.HasInfo(key):
            _copy_list(getattr(source, name), getattr(target, name))
    if isinstance(source, Sdf.AttributeSpec):
        _merge_values(edits, layer, path, to_layer)


def _copy_list(source: Any, target: Any) -> None:
    """Bring the edits of a list of paths over: as a whole where it says all, else those it makes, over those there."""
    if source.isExplicit:
        target.ClearEditsAndMakeExplicit()
        target.explicitItems = list(source.explicitItems)
        return
    for name in ("prependedItems", "appendedItems", "deletedItems", "orderedItems"):
        if items := list(getattr(source, name)):
            others = [item for item in getattr(target, name) if item not in items]
            setattr(target, name, others + items if name == "appendedItems" else items + others)


def _create(layer: Sdf.Layer, source: Sdf.Spec) -> Sdf.Spec:
    if isinstance(source, Sdf.PrimSpec):
        return Sdf.CreatePrimInLayer(layer, source.path)
    prim = Sdf.CreatePrimInLayer(layer, source.path.GetPrimPath())
    if isinstance(source, Sdf.RelationshipSpec):
        return Sdf.RelationshipSpec(prim, source.name, source.custom)
    return Sdf.AttributeSpec(prim, source.name, source.typeName, source.variability, source.custom)


def _combined(value: Any, weaker: Any) -> Any:
    """A value over another one: lists of edits, such as inherits, are put together."""
    if weaker is None or not hasattr(value, "ApplyOperations"):
        return value
    combined = value.ApplyOperations(weaker)
    return value if combined is None else combined


def _merge_values(edits: Sdf.Layer, layer: Sdf.Layer, path: Sdf.Path, to_layer: Time) -> None:
    source, target = edits.GetAttributeAtPath(path), layer.GetAttributeAtPath(path)
    times = edits.ListTimeSamplesForPath(path)
    if not source.HasInfo("default") and not times:
        return
    # Old samples would go on beside new ones, for another topology.
    target.ClearDefaultValue()
    target.ClearInfo("timeSamples")
    if source.HasInfo("default"):
        target.default = source.default
    for time in times:
        layer.SetTimeSample(path, to_layer(time), edits.QueryTimeSample(path, time))
