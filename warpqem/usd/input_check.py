"""Look at the files of an input before USD composes a stage from them.

USD trusts its files: nesting that is deep enough ends the process, references that double at every level never end, and
a layer may name any file of the machine, also one that never ends. Everything here is an error with the file's name
instead. Files that no layer of the input names are not looked at.
"""

from __future__ import annotations

import os
import re
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from pxr import Ar, Pcp, Sdf, Tf, Usd, UsdUtils

from warpqem.errors import StageError
from warpqem.opening import opening
from warpqem.usd.usd_errors import first_line, usd_errors_named

__all__ = ["QUOTED", "check_composition", "open_layers"]

# Brackets and prims in each other. Scenes have some dozens; USD's own stack ends between 20 000 and 100 000.
MOST_NESTED = 1000
# Layers of one input. Large sets have some thousands.
MOST_LAYERS = 20_000
# Prims that references make of the ones that are written, each counted where it is seen (those of instances once).
# USD takes some minutes for so many.
MOST_PRIMS = 20_000_000
# Text is looked at as a whole, so it must fit in memory several times over; larger scenes are binary.
MOST_TEXT_BYTES = 4 * 2**30
# A package is a zip archive of files that are stored as they are; a directory of more of them is no asset.
MOST_PACKAGE_FILES = 100_000

CRATE, TEXT, PACKAGE = b"PXR-USDC", (b"#usda", b"#sdf"), b"PK\x03\x04"
# What brackets may stand in without being any: strings, asset paths, comments.
QUOTED = re.compile(
    rb'"""(?:[^"\\]|\\.|"(?!""))*"""|\'\'\'(?:[^\'\\]|\\.|\'(?!\'\'))*\'\'\'|"(?:[^"\\\n]|\\.)*"|\'(?:[^\'\\\n]|\\.)*\''
    rb"|@@@.*?@@@|@[^@\n]*@|#[^\n]*|//[^\n]*|/\*.*?\*/",
    re.DOTALL,
)
_STEPS = np.zeros(256, dtype=np.int8)
_STEPS[list(b"([{")] = 1
_STEPS[list(b")]}")] = -1
# Bytes whose nesting is counted at a time.
_BLOCK = 2**24


def open_layers(path: str | os.PathLike[str], roots: Sequence[str | os.PathLike[str]] = ()) -> list[Sdf.Layer]:
    """Open a file and all layers that it needs, each after a look at its bytes.

    Args:
        path: The file.
        roots: Folders that all layers must be in, or in that of the input; empty for anywhere.

    Returns:
        The layers, the one of the file first. A stage that is opened while they are held does not read them again.

    Raises:
        StageError: a file is missing, is no regular file, lies elsewhere, or is nothing USD could read safely.
    """
    first = os.path.abspath(path)
    if not Path(first).is_file():
        kind = "no regular file" if Path(first).exists() else "no such file"
        raise StageError(f"{path}: {kind}")
    allowed = [Path(root).resolve() for root in (*roots, Path(first).parent)] if roots else []
    layers: dict[str, Sdf.Layer] = {}
    waiting = [(first, "")]
    while waiting:
        place, named_by = waiting.pop()
        if place in layers:
            continue
        if len(layers) >= MOST_LAYERS:
            raise StageError(f"{path}: more than {MOST_LAYERS} layers")
        layer = _open(place, named_by, allowed)
        if layer is None:
            if place == first:
                raise StageError(f"{path}: USD cannot open it")
            continue
        layers[place] = layer
        waiting += [(file, place) for file in _layers_of(layer)]
    _check_prim_count(first, layers)
    if allowed:
        _check_places(first, allowed)
    return list(layers.values())


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


def _open(place: str, named_by: str, allowed: list[Path]) -> Sdf.Layer | None:
    file = place.split("[", 1)[0] if "[" in place and not os.path.exists(place) else place
    by = f" (named by {named_by})" if named_by else ""
    if allowed and not any(Path(file).resolve().is_relative_to(root) for root in allowed):
        raise StageError(f"{file}{by}: outside of {', '.join(map(str, allowed))}")
    if not Path(file).exists():
        return None  # the stage reports it, with the prim that it is missing for
    if not Path(file).is_file():
        raise StageError(f"{file}{by}: no regular file")
    _check_bytes(file, by)
    try:
        with opening(place):
            layer = Sdf.Layer.FindOrOpen(place)
            if layer is not None:
                _check_specs(layer, place + by)
        return layer
    except (Tf.ErrorException, UnicodeDecodeError) as error:
        raise StageError(f"{place}{by}: USD cannot open it ({first_line(error)})") from error


def _check_specs(layer: Sdf.Layer, name: str) -> None:
    """Look for what a damaged file lists but does not hold, and for times that are no number: USD crashes there.

    Only through lookups by path, which give None for what is missing or of another kind, and never through lists of
    specs.
    """
    waiting = [(Sdf.Path.absoluteRootPath, Sdf.PrimSpec)]
    while waiting:
        path, kind = waiting.pop()
        spec = layer.GetObjectAtPath(path)
        if not isinstance(spec, kind):
            raise StageError(f"{name}: damaged: {path} is listed, but is not there")
        waiting += [(path.AppendChild(child), Sdf.PrimSpec) for child in _listed(spec, "primChildren", name)]
        for group in _listed(spec, "variantSetChildren", name):
            waiting.append((path.AppendVariantSelection(group, ""), Sdf.VariantSetSpec))
        for variant in _listed(spec, "variantChildren", name):
            place = path.GetParentPath().AppendVariantSelection(path.GetVariantSelection()[0], variant)
            waiting.append((place, Sdf.VariantSpec))
        for child in _listed(spec, "properties", name):
            place = path.AppendProperty(child)
            if not isinstance(layer.GetObjectAtPath(place), Sdf.PropertySpec):
                raise StageError(f"{name}: damaged: {place} is listed, but is not there")
            if layer.GetNumTimeSamplesForPath(place) and np.isnan(layer.ListTimeSamplesForPath(place)).any():
                raise StageError(f"{name}: {place} has a sample at time nan")


def _listed(spec: Sdf.Spec, key: str, name: str) -> list[str]:
    """The names below a spec."""
    names = spec.GetInfo(key) if spec.HasInfo(key) else []
    if not isinstance(names, list) or not all(isinstance(child, str) for child in names):
        raise StageError(f"{name}: damaged: {key} of {spec.path} is {type(names).__name__}, no list of names")
    return names


def _layers_of(layer: Sdf.Layer) -> Iterator[str]:
    """Where the layers are that a layer names, in any variant; not value clips, which are opened when they are read."""
    with usd_errors_named(layer.identifier):
        named = layer.GetCompositionAssetDependencies()
    for asset in named:
        if not asset:
            continue
        resolved = Ar.GetResolver().Resolve(Sdf.ComputeAssetPathRelativeToLayer(layer, asset))
        place = str(resolved) or layer.ComputeAbsolutePath(asset)
        if os.path.isabs(place):
            yield place


def _check_places(path: str, allowed: list[Path]) -> None:
    """Look at where textures, clips and all else are that an input names."""
    layers, assets, _ = UsdUtils.ComputeAllDependencies(Sdf.AssetPath(path))
    for place in [layer.realPath for layer in layers] + [os.fspath(asset) for asset in assets]:
        file = Path(place.split("[", 1)[0])
        if place and not any(file.resolve().is_relative_to(root) for root in allowed):
            raise StageError(f"{place} (named by {path}): outside of {', '.join(map(str, allowed))}")


def _check_bytes(file: str, by: str) -> None:
    with open(file, "rb") as stream:
        start = stream.read(8)
        if start.startswith(TEXT):
            if os.path.getsize(file) > MOST_TEXT_BYTES:
                raise StageError(f"{file}{by}: text of more than {MOST_TEXT_BYTES} bytes; binary files may be larger")
            _check_nesting(start + stream.read(), file + by)
        elif start.startswith(PACKAGE):
            _check_package(file, by)


def _check_nesting(text: bytes, name: str) -> None:
    steps = _STEPS[np.frombuffer(QUOTED.sub(b" ", text), dtype=np.uint8)]
    depth = 0
    for start in range(0, len(steps), _BLOCK):
        depths = depth + np.cumsum(steps[start : start + _BLOCK], dtype=np.int32)
        if depths.max() > MOST_NESTED:
            raise StageError(f"{name}: brackets nested more than {MOST_NESTED} deep")
        depth = int(depths[-1])


def _check_package(file: str, by: str) -> None:
    try:
        with zipfile.ZipFile(file) as package:
            entries = package.infolist()
            if len(entries) > MOST_PACKAGE_FILES:
                raise StageError(f"{file}{by}: a package of more than {MOST_PACKAGE_FILES} files")
            size = os.path.getsize(file)
            for entry in entries:
                if entry.compress_type != zipfile.ZIP_STORED or entry.file_size != entry.compress_size:
                    raise StageError(f"{file}{by}: {entry.filename} in the package is compressed, which USD forbids")
                if entry.file_size > size:
                    raise StageError(f"{file}{by}: {entry.filename} in the package is said to be larger than it")
                if entry.filename.startswith(("/", "\\")) or ".." in Path(entry.filename).parts:
                    raise StageError(f"{file}{by}: {entry.filename} in the package names a place outside of it")
                with package.open(entry) as stream:
                    start = stream.read(8)
                    if start.startswith(TEXT):
                        _check_nesting(start + stream.read(), f"{file}[{entry.filename}]{by}")
    except (zipfile.BadZipFile, NotImplementedError, EOFError, OSError, ValueError, RuntimeError) as error:
        raise StageError(f"{file}{by}: no package that could be read ({error})") from error


def _check_prim_count(first: str, layers: dict[str, Sdf.Layer]) -> None:
    """Count the prims that references make, without composing them."""
    counter = _PrimCounter({layer.identifier: layer for layer in layers.values()})
    total = 0
    for layer in layers.values():
        total += counter.count(layer, Sdf.Path.absoluteRootPath)
        if total > MOST_PRIMS:
            raise StageError(f"{first}: references make more than {MOST_PRIMS} prims")


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
