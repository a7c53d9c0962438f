"""Levels of detail of one file: what every form of them shares, and levels as the variants of a root prim."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pxr import Sdf, Usd

from warpqem.errors import OptionError, StageError
from warpqem.files.outputs import OutputFile
from warpqem.usd.commands.output_names import LEVEL_NAME, VARIANT_SET, level_file
from warpqem.usd.layers.asset_paths import move_asset_paths, relative_path
from warpqem.usd.layers.field_order import with_fields_in_order
from warpqem.usd.read.open_stage import MeshSelection
from warpqem.usd.read.stage_views import copy_stage_metadata, layer_name, unopened
from warpqem.usd.write.layer_files import export_layer
from warpqem.usd.write.lod_targets import OutsideTargets
from warpqem.usd.write.map_files import place_maps
from warpqem.usd.write.package import is_package, write_package_with_layers
from warpqem.usd.write.stage_report import PrimReport
from warpqem.usd.write.write import OverLayer

__all__ = ["FileLevels", "LevelLayer", "LevelReport", "VariantLevels", "define_root"]


@dataclass
class LevelReport(PrimReport):
    """The outcome for one mesh on one level.

    Attributes:
        level: Name of the variant.
    """

    level: str = ""


class LevelLayer(ABC):
    """A layer that shows an input file with a choice of levels, kept in memory until saved.

    Each root prim of the input that holds meshes to simplify gets the levels; they reference the input and hold edits
    over it. The input is no sublayer, as its opinions would then be local ones, which are stronger than those of
    variants and references. Other root prims are references to those of the input.
    """

    def __init__(self, source: Usd.Stage, selection: MeshSelection) -> None:
        """Start a layer with LOD0, the input as it is.

        Args:
            source: Stage of the input file.
            selection: The meshes in which the levels differ.

        Raises:
            OptionError: a root prim of the input cannot hold levels.
        """
        self._source = source.GetRootLayer()
        # References are to what is in files, without instances that are opened.
        self._stage_of_input = unopened(source)
        held = {path.GetPrefixes()[0] for path in selection.paths()}
        # Those that nothing defines, too: they can hold collections that materials are bound by.
        roots = self._stage_of_input.GetPseudoRoot().GetAllChildren()
        self._roots: list[Usd.Prim] = [prim for prim in roots if prim.GetPath() in held]
        if not self._roots:
            raise OptionError("lods: the input has no root prim with meshes that could hold the levels")
        self._targets = {prim.GetPath(): OutsideTargets(prim) for prim in roots}
        self._layer = Sdf.Layer.CreateAnonymous("levels.usda")
        copy_stage_metadata(self._source, self._layer)
        default = self._stage_of_input.GetDefaultPrim() or self._roots[0]
        self._layer.defaultPrim = default.GetPath().GetPrefixes()[0].name
        self._places: dict[str, dict[Sdf.Path, Sdf.Path]] = {}
        # Point samples are in the files of the edits until the levels are saved.
        self._edits: list[OverLayer] = []
        self._others = [prim.GetPath() for prim in roots if prim not in self._roots]
        for root in self._roots:
            self._start(root)
        self._add(None)
        for other in (prim for prim in roots if prim not in self._roots):
            self._reference(define_root(self._layer, other), other.GetPath())

    @abstractmethod
    def _start(self, root: Usd.Prim) -> None:
        """Make ready a root prim that holds levels."""

    @abstractmethod
    def _place(self, root: Usd.Prim, name: str) -> Sdf.Path:
        """Make room for a level; returns the path of the spec that is to hold its edits and its reference."""

    def add(self, edits: OverLayer, share: float) -> str:
        """Add the next level.

        Args:
            edits: Edits over the input, all below root prims that hold the levels.
            share: Faces of the level per face of the input.

        Returns:
            The name of the level.

        Raises:
            StageError: USD cannot copy the edits.
        """
        return self._add(edits)

    def save(self, output: Path, other_outputs: Sequence[OutputFile] = ()) -> list[str]:
        """Write the layer under a temporary name and rename it.

        Args:
            output: Path checked with `check_output_path`; a package holds the layers of the input, too.
            other_outputs: What else is going to be written: no image may take its place.

        Returns:
            What programs may not read; one line each.

        Raises:
            StageError: the file cannot be written; nothing is left behind.
            OptionError: an image would take the place of a file that is read, or of another output.
        """
        for path in self._others:
            self._targets[path].write(self._layer, path, self._on_all_levels)
        # A copy, because an anonymous layer that a stage is open on cannot resolve a relative path.
        layer = Sdf.Layer.CreateAnonymous("save.usda")
        layer.TransferContent(self._layer)
        name = layer_name(self._source)
        if is_package(output):
            return write_package_with_layers(with_fields_in_order(layer), output)
        sets = [(f"{LEVEL_NAME}{level}_", edits.maps) for level, edits in enumerate(self._edits, start=1)]
        place_maps(layer, sets, output, self._stage_of_input, other_outputs)
        if os.path.isabs(name):
            layer.UpdateCompositionAssetDependency(name, relative_path(name, output.parent))
        move_asset_paths(layer, self._source, output.parent)
        export_layer(with_fields_in_order(layer), output)
        return []

    def _add(self, edits: OverLayer | None) -> str:
        name = f"{LEVEL_NAME}{len(self._places)}"
        places = self._places[name] = {root.GetPath(): self._place(root, name) for root in self._roots}
        if edits is not None:
            self._edits.append(edits)
        for root, place in places.items():
            if edits is not None:
                self._copy(edits.layer, root, place)
            self._reference(self._layer.GetPrimAtPath(place), root)
            self._targets[root].write(self._layer, place, lambda target: [self._on_level(target, name)])
        return name

    def _on_level(self, path: Sdf.Path, name: str) -> Sdf.Path:
        """Where what is at a path of the input is on a level."""
        root = path.GetPrefixes()[0]
        place = self._places[name].get(root)
        return path if place is None else path.ReplacePrefix(root, place.StripAllVariantSelections())

    def _on_all_levels(self, path: Sdf.Path) -> list[Sdf.Path]:
        return list(dict.fromkeys(self._on_level(path, name) for name in self._places))

    def _copy(self, edits: Sdf.Layer, root: Sdf.Path, place: Sdf.Path) -> None:
        """Copy the edits of one level below one root prim, if it has any."""
        if edits.GetPrimAtPath(root) and not Sdf.CopySpec(edits, root, self._layer, place):
            raise StageError(f"{root}: USD cannot copy edits to {place}")

    def _reference(self, prim: Sdf.PrimSpec, path: Sdf.Path) -> None:
        prim.referenceList.Prepend(Sdf.Reference(layer_name(self._source), path))


class VariantLevels(LevelLayer):
    """Levels as the variants LOD0, LOD1, ... of a variant set `LOD` on each root prim; LOD0 is selected."""

    def _start(self, root: Usd.Prim) -> None:
        if root.GetVariantSets().HasVariantSet(VARIANT_SET):
            raise OptionError(f"lods: {root.GetPath()} has a variant set {VARIANT_SET} already")
        prim = define_root(self._layer, root)
        prim.variantSetNameList.Prepend(VARIANT_SET)
        Sdf.VariantSetSpec(prim, VARIANT_SET)
        prim.variantSelections[VARIANT_SET] = f"{LEVEL_NAME}0"

    def _place(self, root: Usd.Prim, name: str) -> Sdf.Path:
        return Sdf.VariantSpec(self._layer.GetPrimAtPath(root.GetPath()).variantSets[VARIANT_SET], name).path


class FileLevels:
    """Levels as files beside the output, each like the output of a simplification to one ratio.

    Args:
        flatten: Write self-contained files.

    """

    def __init__(self, flatten: bool) -> None:
        self._flatten = flatten
        self._levels: list[OverLayer] = []

    def add(self, edits: OverLayer, share: float) -> str:
        """Add the next level; see `LevelLayer.add`."""
        self._levels.append(edits)
        return f"{LEVEL_NAME}{len(self._levels)}"

    def save(self, output: Path, other_outputs: Sequence[OutputFile] = ()) -> list[str]:
        """Write the files; see `OverLayer.save`."""
        problems = []
        for level, edits in enumerate(self._levels, start=1):
            problems += edits.save(Path(level_file(output, level)), self._flatten, other_outputs)
        return problems


def define_root(layer: Sdf.Layer, prim: Usd.Prim) -> Sdf.PrimSpec:
    """A root prim on a layer with the specifier and type it has on a stage."""
    return Sdf.PrimSpec(layer, prim.GetName(), prim.GetSpecifier(), prim.GetTypeName())
