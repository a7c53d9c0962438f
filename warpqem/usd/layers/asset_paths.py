"""How layers name files: relative to their own folder, in a way that USD finds them again."""

from __future__ import annotations

import os
from pathlib import Path

from pxr import Ar, Sdf, UsdUtils

from warpqem.errors import StageError

__all__ = ["move_asset_paths", "name_from", "relative_path"]


def relative_path(target: str, folder: Path) -> str:
    """Path from a folder to a file, anchored so that USD does not look for it on its search path."""
    try:
        relative = os.path.relpath(target, folder)
    except ValueError:
        # On Windows there is no relative path from one drive to another.
        return Path(target).as_posix()
    relative = Path(relative).as_posix()
    return relative if relative.startswith("../") else f"./{relative}"


def name_from(output: Path, target: str) -> str:
    """How a layer names a file.

    Raises:
        StageError: USD would not find the file by this name, such as one with a backslash, which it takes for a slash.
    """
    if not os.path.isabs(target):
        return target
    path = relative_path(target, output.parent)
    found = Ar.GetResolver().CreateIdentifier(path, Ar.ResolvedPath(os.fspath(output)))
    if os.path.realpath(found) != os.path.realpath(target):
        raise StageError(f"{target!r}: no layer can name a file of this name (USD would look for {found!r})")
    return path


def move_asset_paths(layer: Sdf.Layer, source: Sdf.Layer, folder: Path) -> None:
    """Make absolute asset paths relative to a folder, if the files exist or lie with the input.

    Flattening makes them absolute, and so does carrying them from a layer in one folder to one in another.

    Args:
        layer: The layer to change.
        source: The root layer of the input.
        folder: The folder the layer is going to be in.
    """
    source_folder = Path(source.realPath).parent

    def move(path: str) -> str:
        package = path.split("[", 1)[0]
        if not os.path.isabs(package) or not (os.path.exists(package) or Path(package).is_relative_to(source_folder)):
            return path
        return relative_path(package, folder) + path[len(package) :]

    # USD takes empty paths out of arrays, which then have too few values for their faces.
    with_gaps = _arrays_with_empty_paths(layer)
    UsdUtils.ModifyAssetPaths(layer, move)
    for path, time, array in with_gaps:
        moved = Sdf.AssetPathArray([Sdf.AssetPath(move(asset.path)) if asset.path else asset for asset in array])
        if time is None:
            layer.GetAttributeAtPath(path).default = moved
        else:
            layer.SetTimeSample(path, time, moved)


def _arrays_with_empty_paths(layer: Sdf.Layer) -> list[tuple[Sdf.Path, float | None, Sdf.AssetPathArray]]:
    """Arrays of asset paths some of which are empty: attribute, time (None for the default value), and value."""
    found: list[tuple[Sdf.Path, float | None, Sdf.AssetPathArray]] = []

    def look(path: Sdf.Path) -> None:
        attribute = layer.GetAttributeAtPath(path) if path.IsPropertyPath() else None
        if attribute is None or attribute.typeName != Sdf.ValueTypeNames.AssetArray:
            return
        values = [(time, layer.QueryTimeSample(path, time)) for time in layer.ListTimeSamplesForPath(path)]
        for time, value in [(None, attribute.default), *values]:
            if isinstance(value, Sdf.AssetPathArray) and not all(asset.path for asset in value):
                found.append((path, time, value))

    layer.Traverse(Sdf.Path.absoluteRootPath, look)
    return found
