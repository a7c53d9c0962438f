"""One order of the fields of a layer, so that a crate file of it has the same bytes on every run."""

from __future__ import annotations

from typing import Any

from pxr import Sdf

__all__ = ["with_fields_in_order"]

SAMPLES = "timeSamples"


def with_fields_in_order(layer: Sdf.Layer) -> Sdf.Layer:
    """A copy of a layer whose fields were authored in the order of its text.

    USD copies the fields of a spec in the order of addresses in memory, and a crate file keeps the order in which they
    were authored. Values go from layer to layer as they are, without text and without a copy of their arrays.

    Args:
        layer: An anonymous layer; it loses its values.
    """
    values: list[tuple[Sdf.Path, Any, dict[float, Any]]] = []

    def take(path: Sdf.Path) -> None:
        attribute = layer.GetAttributeAtPath(path) if path.IsPropertyPath() else None
        if attribute is not None:
            samples = {time: layer.QueryTimeSample(path, time) for time in layer.ListTimeSamplesForPath(path)}
            values.append((path, attribute.default if attribute.HasDefaultValue() else None, samples))
            attribute.ClearDefaultValue()
            attribute.ClearInfo(SAMPLES)

    layer.Traverse(Sdf.Path.absoluteRootPath, take)
    ordered = Sdf.Layer.CreateAnonymous("ordered.usda")
    ordered.ImportFromString(layer.ExportToString())
    for path, default, samples in sorted(values, key=lambda entry: entry[0]):
        if default is not None:
            ordered.GetAttributeAtPath(path).default = default
        for time, value in samples.items():
            ordered.SetTimeSample(path, time, value)
    return ordered
