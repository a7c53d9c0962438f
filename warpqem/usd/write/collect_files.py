"""Textures and other files that a flat layer names, gathered so that the layer needs no file elsewhere."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from pxr import Ar, Sdf, Usd

from warpqem.errors import StageError
from warpqem.files.file_kinds import kind_of
from warpqem.files.temporary import replacing
from warpqem.usd.checks.named_assets import ASSET_TYPES, UDIM, evaluated
from warpqem.usd.checks.named_by import PICTURES
from warpqem.usd.read.copy_asset import copy_asset

__all__ = ["Collection", "collect_files", "is_media", "lies_elsewhere", "write_collected"]

# What attributes name beside pictures that belongs to an asset: the sounds of UsdMedia.
SOUNDS = re.compile(r"\.(m4a|mp3|wav)$", re.IGNORECASE)
# Tiles count from 1001, ten to a row; a hundred rows are more than any program reads.
TILES = range(1001, 2001)


@dataclass
class Collection:
    """What was gathered from a layer.

    Attributes:
        files: Resolved path of each file, which may lead into a package, by its path from the layer's folder.
        problems: Files that could not be gathered, one line each.
    """

    files: dict[str, str] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)


def is_media(place: str) -> bool:
    """True for the name of a picture or a sound."""
    return bool(PICTURES.search(_last_name(place)) or SOUNDS.search(place))


def lies_elsewhere(place: str, folder: Path) -> bool:
    """True for a picture or sound outside of a folder, and for any file in a package."""
    if Ar.IsPackageRelativePath(place):
        return True
    return is_media(place) and not Path(os.path.realpath(place)).is_relative_to(os.path.realpath(folder))


def collect_files(layer: Sdf.Layer, folder: str, wanted: Callable[[str], bool], context: Usd.Stage) -> Collection:
    """Let the attributes of a layer name their files in one folder, and say which files must be put there.

    Args:
        layer: A flat layer; the values of its attributes of type asset are changed.
        folder: Name of the folder, beside the layer.
        wanted: Whether a file is to be gathered, by its resolved path.
        context: The stage that was flattened; its resolver context finds the files.

    Returns:
        The files. What is missing, no regular file or a layer keeps its name; the latter two are problems.
    """
    names = _Names(folder, wanted)
    with Ar.ResolverContextBinder(context.GetPathResolverContext()):
        for path in _asset_attributes(layer):
            attribute = layer.GetAttributeAtPath(path)
            rename = names.renamer(str(path), layer.expressionVariables)
            if attribute.HasDefaultValue() and not isinstance(attribute.default, Sdf.ValueBlock):
                attribute.default = _mapped(attribute.default, rename)
            for time in layer.ListTimeSamplesForPath(path):
                value = layer.QueryTimeSample(path, time)
                if isinstance(value, (Sdf.AssetPath, Sdf.AssetPathArray)):
                    layer.SetTimeSample(path, time, _mapped(value, rename))
    names.collection.problems = list(dict.fromkeys(names.collection.problems))
    return names.collection


def write_collected(collection: Collection, folder: Path) -> None:
    """Write the gathered files below a folder, each under a temporary name first.

    Args:
        collection: What was gathered.
        folder: The folder of the layer.

    Raises:
        StageError: a file cannot be read or written.
    """
    for name, source in collection.files.items():
        target = folder / name
        try:
            target.parent.mkdir(exist_ok=True)
            with replacing(target) as temporary, open(temporary, "wb") as file:
                copy_asset(source, file)
        except OSError as error:
            raise StageError(f"{target}: cannot be written ({error.strerror or error})") from error


@dataclass
class _Names:
    """Names in one folder for files from anywhere, each given once."""

    folder: str
    wanted: Callable[[str], bool]
    collection: Collection = field(default_factory=Collection)
    _given: dict[str, str] = field(default_factory=dict)
    _taken: set[str] = field(default_factory=set)

    def renamer(self, owner: str, variables: dict[str, object]) -> Callable[[str], str]:
        """What gives the new name of a file that an attribute names."""
        return lambda name: self._name(owner, name, evaluated(name, variables))

    def _name(self, owner: str, authored: str, path: str) -> str:
        if UDIM in path:
            tiles = [(tile, _resolved(path.replace(UDIM, str(tile)))) for tile in TILES]
            found = {str(tile): place for tile, place in tiles if place}
        else:
            found = {"": place} if (place := _resolved(path)) else {}
        if not found:
            return authored
        places = {tile: place for tile, place in found.items() if self._can_be_had(owner, place)}
        if not places:
            return authored
        new = self._new_name(path if UDIM in path else next(iter(places.values())))
        for tile, place in places.items():
            self.collection.files[new.replace(UDIM, tile)] = place
        return f"./{new}"

    def _can_be_had(self, owner: str, place: str) -> bool:
        if not self.wanted(place):
            return False
        kind = None if Ar.IsPackageRelativePath(place) else kind_of(place)
        if kind is not None:
            self.collection.problems.append(f"{owner}: {place}: left where it is, no regular file but {kind}")
        elif Usd.Stage.IsSupportedFile(place):
            self.collection.problems.append(f"{owner}: {place}: left where it is, a layer with files of its own")
        return kind is None and not Usd.Stage.IsSupportedFile(place)

    def _new_name(self, place: str) -> str:
        """A name of its own in any case of its letters, since folders may ignore that."""
        if place not in self._given:
            name = last = _last_name(place)
            count = 1
            while name.casefold() in self._taken:
                count += 1
                # In front, as behind it there may be the number of a tile.
                name = f"{count}_{last}"
            self._taken.add(name.casefold())
            self._given[place] = f"{self.folder}/{name}"
        return self._given[place]


def _resolved(path: str) -> str:
    return str(Ar.GetResolver().Resolve(path)) if path else ""


def _last_name(place: str) -> str:
    """The name of a file without its folder, and without the packages it is in."""
    inner = Ar.SplitPackageRelativePathInner(place)[1] if Ar.IsPackageRelativePath(place) else place
    return os.path.basename(str(inner))


def _asset_attributes(layer: Sdf.Layer) -> Iterator[Sdf.Path]:
    found: list[Sdf.Path] = []

    def look(path: Sdf.Path) -> None:
        attribute = layer.GetAttributeAtPath(path) if path.IsPropertyPath() else None
        if attribute is not None and attribute.typeName in ASSET_TYPES:
            found.append(path)

    layer.Traverse(Sdf.Path.absoluteRootPath, look)
    # In one order whatever the layer is like in memory, so that names come out the same.
    yield from sorted(found)


def _mapped(value: Sdf.AssetPath | Sdf.AssetPathArray, rename: Callable[[str], str]) -> object:
    if isinstance(value, Sdf.AssetPath):
        return Sdf.AssetPath(rename(value.path)) if value.path else value
    return Sdf.AssetPathArray([Sdf.AssetPath(rename(entry.path)) if entry.path else entry for entry in value])
