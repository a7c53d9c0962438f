"""Look at the files of an input before USD composes a stage from them.

USD trusts its files: nesting that is deep enough ends the process, references that double at every level never end, and
a layer may name any file of the machine, also one that never ends. Everything here is an error with the file's name
instead. Files that no layer of the input names are not looked at.
"""

from __future__ import annotations

import io
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Ar, Pcp, Sdf, Tf, Usd

from warpqem.errors import StageError
from warpqem.files.file_kinds import check_regular, kind_of
from warpqem.files.formats import how_to_read
from warpqem.runtime.load_timeout import load_timeout
from warpqem.usd.checks.byte_check import CRATE, check_bytes, check_stream
from warpqem.usd.checks.named_assets import ASSET_TYPES, CLIPS, NamedAsset, clips_of, layers_of, outer_file, textures_of
from warpqem.usd.checks.usd_errors import first_line

__all__ = ["OpenedLayers", "check_composition", "open_layer", "open_layers"]

# Layers of one input. Large sets have some thousands.
MAX_LAYERS = 20_000
# Prims that references make of the ones that are written, each counted where it is seen (those of instances once).
# USD takes some minutes for so many.
MAX_PRIMS = 20_000_000


@dataclass
class OpenedLayers:
    """The layers of an input. A stage that is opened while they are held does not read them again.

    Attributes:
        layers: The layers, the one of the file first.
        files: All files that are needed: those of the layers, value clips and textures, also such as are missing.
        problems: What is wrong with other files that they name, such as a texture that is a pipe; one line each.
    """

    layers: list[Sdf.Layer] = field(default_factory=list)
    files: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)


@dataclass
class _Specs:
    """What a layer names files in beside its arcs: prims with value clips, and attributes of type asset."""

    clips: list[Sdf.Path] = field(default_factory=list)
    assets: list[Sdf.Path] = field(default_factory=list)


def open_layers(path: str | os.PathLike[str], roots: Sequence[str | os.PathLike[str]] = ()) -> OpenedLayers:
    """Open a file and all layers that it needs, each after a look at its bytes; value clips are looked at, too.

    Args:
        path: The file.
        roots: Folders that all files it names must be in, or in that of the input; empty for anywhere.

    Raises:
        StageError: a file is missing, is no regular file, lies elsewhere, or is nothing USD could read safely.
    """
    _check_name(path)
    first = place_of_input(path)
    check_regular(outer_file(first), StageError, os.fspath(path))
    if not _exists(first):
        raise StageError(f"{path}: no such file")
    if os.path.isfile(first) and Sdf.FileFormat.FindByExtension(first) is None:
        raise StageError(f"{path}: {how_to_read(first)}")
    allowed = [Path(root).resolve() for root in (*roots, Path(outer_file(first)).parent)] if roots else []
    layers: dict[str, Sdf.Layer] = {}
    named = _NamedFiles(allowed)
    variables: dict[str, Any] = {}
    waiting = [(first, "")]
    while waiting:
        place, named_by = waiting.pop()
        if place in layers:
            continue
        if len(layers) >= MAX_LAYERS:
            raise StageError(f"{path}: more than {MAX_LAYERS} layers")
        named.files[outer_file(place)] = None
        layer, specs = _open(place, f" (named by {named_by})" if named_by else "", allowed)
        if layer is None:
            if place == first:
                raise StageError(f"{path}: USD cannot open it")
            continue
        variables = variables if layers else dict(layer.expressionVariables)
        layers[place] = layer
        named.add(layer, specs, variables)
        waiting += [(file, place) for file in layers_of(layer, variables)]
    _check_prim_count(first, layers)
    return OpenedLayers(list(layers.values()), list(named.files), named.problems)


def place_of_input(path: str | os.PathLike[str]) -> str:
    """Where USD's resolver finds an input; the absolute path of a file that it does not find."""
    name = os.fspath(path)
    if Sdf.Layer.IsAnonymousLayerIdentifier(name):
        return name
    try:
        return str(Ar.GetResolver().Resolve(name)) or os.path.abspath(name)
    except Tf.ErrorException:
        return os.path.abspath(name)


def _exists(place: str) -> bool:
    """Whether there is a file, something in a package or wherever else a resolver looks, or a layer in memory."""
    if Sdf.Layer.IsAnonymousLayerIdentifier(place):
        return Sdf.Layer.Find(place) is not None
    return os.path.exists(place) or bool(Ar.GetResolver().Resolve(place))


class _NamedFiles:
    """The files that layers name, and what is wrong with those that are no layers."""

    def __init__(self, allowed: list[Path]) -> None:
        self.files: dict[str, None] = {}
        self.problems: list[str] = []
        self._allowed = allowed

    def add(self, layer: Sdf.Layer, specs: _Specs, variables: dict[str, Any]) -> None:
        """Look at the value clips and textures of a layer.

        Raises:
            StageError: a clip is nothing USD could read safely, or a file lies outside of the folders allowed.
        """
        for clip in clips_of(layer, specs.clips, variables):
            if self._is_new(clip):
                self.problems += _check_clip(clip, layer.identifier, self._allowed)
        for texture in textures_of(layer, specs.assets, variables):
            file = outer_file(texture.place)
            if self._is_new(texture):
                _check_place(file, f" (named by {texture.owner} in {layer.identifier})", self._allowed)
            kind = kind_of(file)
            if kind is not None:
                name = f"{texture.owner} in {layer.identifier}: {texture.path}"
                self.problems.append(f"{name} is no regular file, but {kind}")

    def _is_new(self, asset: NamedAsset) -> bool:
        count = len(self.files)
        self.files[outer_file(asset.place)] = None
        return len(self.files) > count


def check_composition(stage: Usd.Stage) -> list[str]:
    """What is wrong with how a stage is composed, such as references to what is missing; one line each.

    Raises:
        StageError: a layer or prim refers to itself, which leaves out what it stands for.
    """
    problems = []
    for error in _composition_errors(stage):
        try:
            text = " ".join(str(error).split())
        except UnicodeDecodeError:
            text = f"{type(error).__name__} with a path that is no text"
        if isinstance(error, (Pcp.ErrorArcCycle, Pcp.ErrorSublayerCycle)):
            raise StageError(f"{stage.GetRootLayer().realPath}: {text}")
        problems.append(text)
    return problems


def _composition_errors(stage: Usd.Stage) -> list[Pcp.ErrorBase]:
    """The composition errors of all prims of a stage, as ``GetCompositionErrors`` gives them from USD 24.08 on."""
    if hasattr(stage, "GetCompositionErrors"):
        return list(stage.GetCompositionErrors())
    root = stage.GetPseudoRoot()
    errors = list(root.GetPrimIndex().rootNode.layerStack.localErrors)
    for prim in Usd.PrimRange(root, Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate)):
        errors += prim.GetPrimIndex().localErrors
    return errors


def open_layer(place: str) -> Sdf.Layer | None:
    """Open one layer after a look at its bytes; None for one that is missing or cannot be opened.

    Raises:
        StageError: it is no regular file, or is nothing USD could read safely.
    """
    return _open(place, "", [])[0]


def _check_name(path: str | os.PathLike[str]) -> None:
    if not os.fspath(path):
        raise StageError("the name of the file to read is empty")
    try:
        os.fspath(path).encode("utf-8")
    except UnicodeEncodeError as error:
        raise StageError(f"{os.fspath(path)}: USD reads no file whose name is not UTF-8") from error


def _open(place: str, by: str, allowed: list[Path]) -> tuple[Sdf.Layer | None, _Specs]:
    specs = _Specs()
    if Sdf.Layer.IsAnonymousLayerIdentifier(place):
        layer = Sdf.Layer.Find(place)
        if layer is not None:
            _check_specs(layer, place + by, specs)
        return layer, specs
    if by and not _has_format(place):
        _check_place(outer_file(place), by, allowed)
        return None, specs  # USD leaves it out, and the stage reports it, with the prim that names it
    if not _check_file(place, by, allowed):
        return None, specs  # the stage reports it, with the prim that it is missing for
    try:
        with load_timeout(place):
            layer = Sdf.Layer.FindOrOpen(place)
            if layer is not None:
                _check_rates(layer, place + by)
                _check_specs(layer, place + by, specs)
        return layer, specs
    except (Tf.ErrorException, UnicodeDecodeError) as error:
        raise StageError(f"{place}{by}: USD cannot open it ({first_line(error, place)})") from error


def _has_format(place: str) -> bool:
    """Whether USD, with the plugins that are installed, knows the format of files of this name."""
    extension = Ar.GetResolver().GetExtension(str(Sdf.Layer.SplitIdentifier(place)[0]))
    return bool(extension) and Sdf.FileFormat.FindByExtension(extension) is not None


def _check_clip(clip: NamedAsset, layer: str, allowed: list[Path]) -> list[str]:
    """Check a value clip like a layer, but close it again: an animation may have thousands."""
    by = f" (value clip of {clip.owner} in {layer})"
    if not _check_file(clip.place, by, allowed):
        return [f"{clip.place}{by}: no such file"]
    with open(outer_file(clip.place), "rb") as file:
        # Text has been looked at, and its parser does not crash; to parse it twice would take long.
        if file.read(len(CRATE)) == CRATE:
            _open(clip.place, by, allowed)
    return []


def _check_place(file: str, by: str, allowed: list[Path]) -> None:
    if allowed and not any(Path(os.path.realpath(file)).is_relative_to(root) for root in allowed):
        raise StageError(f"{file}{by}: outside of {', '.join(map(str, allowed))}")


def _check_file(place: str, by: str, allowed: list[Path]) -> bool:
    """Look at a file before USD reads it; false if there is none."""
    file = outer_file(place)
    _check_place(file, by, allowed)
    check_regular(file, StageError, file + by)
    if os.path.exists(file):
        check_bytes(file, by)
        return True
    asset = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(place)) if Ar.GetResolver().Resolve(place) else None
    if asset is not None:
        check_stream(io.BytesIO(asset.GetBuffer()), place, by)
    return asset is not None


def _check_rates(layer: Sdf.Layer, name: str) -> None:
    """Check the rates that times are mapped by: where one is no number, USD never ends its search for samples."""
    # The first stands for the second where a layer has no second one.
    for rate in ("framesPerSecond", "timeCodesPerSecond"):
        value = getattr(layer, rate)
        if not math.isfinite(value):
            raise StageError(f"{name}: {rate} is {value}")


def _check_specs(layer: Sdf.Layer, name: str, found: _Specs) -> None:
    """Look for what a damaged file lists but does not hold, and for times that are no number: USD crashes there.

    Only through lookups by path, which give None for what is missing or of another kind, and never through lists of
    specs. On the way, what names files is found.
    """
    waiting = [(Sdf.Path.absoluteRootPath, Sdf.PrimSpec)]
    while waiting:
        path, kind = waiting.pop()
        spec = layer.GetObjectAtPath(path)
        if not isinstance(spec, kind):
            raise StageError(f"{name}: damaged: {path} is listed, but is not there")
        if spec.HasInfo(CLIPS):
            found.clips.append(path)
        waiting += [(path.AppendChild(child), Sdf.PrimSpec) for child in _listed(spec, "primChildren", name)]
        for group in _listed(spec, "variantSetChildren", name):
            waiting.append((path.AppendVariantSelection(group, ""), Sdf.VariantSetSpec))
        for variant in _listed(spec, "variantChildren", name):
            place = path.GetParentPath().AppendVariantSelection(path.GetVariantSelection()[0], variant)
            waiting.append((place, Sdf.VariantSpec))
        for child in _listed(spec, "properties", name):
            place = path.AppendProperty(child)
            item = layer.GetObjectAtPath(place)
            if not isinstance(item, Sdf.PropertySpec):
                raise StageError(f"{name}: damaged: {place} is listed, but is not there")
            if isinstance(item, Sdf.AttributeSpec) and item.typeName in ASSET_TYPES:
                found.assets.append(place)
            if layer.GetNumTimeSamplesForPath(place) and np.isnan(layer.ListTimeSamplesForPath(place)).any():
                raise StageError(f"{name}: {place} has a sample at time nan")


def _listed(spec: Sdf.Spec, key: str, name: str) -> list[str]:
    """The names below a spec."""
    names = spec.GetInfo(key) if spec.HasInfo(key) else []
    if not isinstance(names, list) or not all(isinstance(child, str) for child in names):
        raise StageError(f"{name}: damaged: {key} of {spec.path} is {type(names).__name__}, no list of names")
    return names


def _check_prim_count(first: str, layers: dict[str, Sdf.Layer]) -> None:
    """Count the prims that references make, without composing them."""
    counter = _PrimCounter({layer.identifier: layer for layer in layers.values()})
    total = 0
    for layer in layers.values():
        total += counter.count(layer, Sdf.Path.absoluteRootPath)
        if total > MAX_PRIMS:
            raise StageError(f"{first}: references make more than {MAX_PRIMS} prims")


class _PrimCounter:
    """How many prims are at and below a spec when all arcs are followed, at most."""

    def __init__(self, layers: dict[str, Sdf.Layer]) -> None:
        self._layers = layers
        self._known: dict[tuple[str, Sdf.Path], int] = {}
        self._begun: dict[tuple[str, Sdf.Path], list[tuple[tuple[str, Sdf.Path], bool]]] = {}

    def count(self, layer: Sdf.Layer, path: Sdf.Path) -> int:
        """Count with a stack of its own, as specs may be nested deeply and refer to each other in circles."""
        root = (layer.identifier, path)
        stack = [root]
        while stack:
            key = stack[-1]
            if key in self._known:
                stack.pop()
            elif key in self._begun:
                needed = self._begun.pop(key)
                # What is begun and comes back to itself counts nothing more; USD leaves that out, too.
                self._known[key] = 1 + sum(self._known.get(need, 0) for need, once in needed if not once)
                stack.pop()
            else:
                self._begun[key] = needed = self._needs(*key)
                stack += [need for need, _ in needed if need not in self._known and need not in self._begun]
        return self._known[root]

    def _needs(self, identifier: str, path: Sdf.Path) -> list[tuple[tuple[str, Sdf.Path], bool]]:
        """Specs whose prims appear at and below one, and whether all who need them share them."""
        layer = self._layers[identifier]
        spec = layer.GetPrimAtPath(path) if path != Sdf.Path.absoluteRootPath else layer.pseudoRoot
        if not spec:
            return []
        needed = [((identifier, child.path), False) for child in spec.nameChildren]
        if spec == layer.pseudoRoot:
            return needed
        once = bool(spec.HasInfo("instanceable") and spec.GetInfo("instanceable"))
        for variant_set in spec.variantSets:
            needed += [((identifier, variant.primSpec.path), False) for variant in variant_set.variants]
        for arcs in (spec.referenceList, spec.payloadList):
            for arc in arcs.GetAddedOrExplicitItems():
                other = self._layer_of(layer, arc.assetPath)
                if other is not None:
                    target = arc.primPath or self._default(other)
                    needed += [((other.identifier, target), once)] if target else []
        for paths in (spec.inheritPathList, spec.specializesList):
            needed += [((identifier, target), once) for target in paths.GetAddedOrExplicitItems()]
        return needed

    def _layer_of(self, layer: Sdf.Layer, asset: str) -> Sdf.Layer | None:
        if not asset:
            return layer
        found = Sdf.Layer.FindRelativeToLayer(layer, asset)
        return self._layers.get(found.identifier) if found else None

    @staticmethod
    def _default(layer: Sdf.Layer) -> Sdf.Path | None:
        return Sdf.Path.absoluteRootPath.AppendChild(layer.defaultPrim) if layer.defaultPrim else None
