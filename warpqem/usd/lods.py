"""Levels of detail of one file: what every form of them shares, and levels as the variants of the default prim."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pxr import Sdf, Usd

from warpqem.errors import OptionError, StageError
from warpqem.outputs import OutputFile
from warpqem.usd.field_order import with_fields_in_order
from warpqem.usd.output_names import LEVEL_NAME, level_file
from warpqem.usd.package import is_package, write_package_with_layers
from warpqem.usd.report import PrimReport
from warpqem.usd.stage import find_meshes
from warpqem.usd.write import OverLayer, copy_stage_metadata, export_layer, move_asset_paths, relative_path

__all__ = ["FileLevels", "LevelLayer", "LevelReport", "VariantLevels", "define_root"]

# The variant set that usdview, Omniverse and others show for levels of detail.
VARIANT_SET = "LOD"


@dataclass
class LevelReport(PrimReport):
    """The outcome for one mesh on one level.

    Attributes:
        level: Name of the variant.
    """

    level: str = ""


class LevelLayer(ABC):
    """A layer that shows an input file with a choice of levels, kept in memory until saved.

    One root prim of the input, the one that holds its default prim, gets the levels; they reference the input and hold
    edits over it. The input is no sublayer, as its opinions would then be local ones, which are stronger than those of
    variants and references. Other root prims are references to those of the input.

    Attributes:
        path: That root prim.
    """

    def __init__(self, source: Usd.Stage, prim_paths: Sequence[str] = ()) -> None:
        """Start a layer with LOD0, the input as it is.

        Args:
            source: Stage of the input file.
            prim_paths: Prim paths; the levels differ in the meshes at and below them. Empty for all.

        Raises:
            OptionError: the input has no single root prim that can hold the levels.
            StageError: one of `prim_paths` does not exist or has no mesh.
        """
        self._source = source.GetRootLayer()
        self._root = _find_root(source)
        self.path: Sdf.Path = self._root.GetPath()
        self._check_meshes(source, prim_paths)
        _check_targets(source)
        self._layer = Sdf.Layer.CreateAnonymous("levels.usda")
        copy_stage_metadata(self._source, self._layer)
        self._layer.defaultPrim = self._root.GetName()
        self._names: list[str] = []
        # Point samples are in the files of the edits until the levels are saved.
        self._edits: list[OverLayer] = []
        self._start()
        for other in source.GetPseudoRoot().GetAllChildren():
            if other != self._root and other.HasDefiningSpecifier():
                self._reference(define_root(self._layer, other), other.GetPath())

    @abstractmethod
    def _start(self) -> None:
        """Define the prim that holds the levels, and LOD0."""

    @abstractmethod
    def _place(self, name: str) -> Sdf.Path:
        """Make room for a level; returns the path of the spec that is to hold its edits and its reference."""

    def add(self, edits: OverLayer, share: float) -> str:
        """Add the next level.

        Args:
            edits: Edits over the input, all below the prim that holds the levels.
            share: Faces of the level per face of the input.

        Returns:
            The name of the level.

        Raises:
            StageError: USD cannot copy the edits.
        """
        return self._add(edits)

    def save(self, output: Path) -> list[str]:
        """Write the layer under a temporary name and rename it.

        Args:
            output: Path checked with `check_output_path`; a package holds the layers of the input, too.

        Returns:
            What programs may not read; one line each.

        Raises:
            StageError: the file cannot be written; nothing is left behind.
        """
        # A copy, because an anonymous layer that a stage is open on cannot resolve a relative path.
        layer = Sdf.Layer.CreateAnonymous("save.usda")
        layer.TransferContent(self._layer)
        if is_package(output):
            return write_package_with_layers(with_fields_in_order(layer), output)
        layer.UpdateCompositionAssetDependency(
            self._source.realPath, relative_path(self._source.realPath, output.parent)
        )
        move_asset_paths(layer, self._source, output.parent)
        export_layer(with_fields_in_order(layer), output)
        return []

    def _add(self, edits: OverLayer | None) -> str:
        name = f"{LEVEL_NAME}{len(self._names)}"
        self._names.append(name)
        path = self._place(name)
        if edits is not None:
            self._edits.append(edits)
            self._copy(edits.layer, path)
        self._reference(self._layer.GetPrimAtPath(path), self.path)
        return name

    def _copy(self, edits: Sdf.Layer, path: Sdf.Path) -> None:
        """Copy the edits of one level, if it has any."""
        if edits.GetPrimAtPath(self.path) and not Sdf.CopySpec(edits, self.path, self._layer, path):
            raise StageError(f"{self.path}: USD cannot copy edits to {path}")

    def _reference(self, prim: Sdf.PrimSpec, path: Sdf.Path) -> None:
        prim.referenceList.Prepend(Sdf.Reference(self._source.realPath, path))

    def _check_meshes(self, source: Usd.Stage, prim_paths: Sequence[str]) -> None:
        selection = find_meshes(source, prim_paths, self.path)
        paths = [prim.GetPath() for prim in selection.prims] + [Sdf.Path(path) for path, _error in selection.refused]
        for path in paths:
            if not path.HasPrefix(self.path):
                raise OptionError(
                    f"lods: the mesh {path} is outside {self.path}, the root prim that holds the levels; "
                    f"move it there, or take other meshes only with --prim"
                )


class VariantLevels(LevelLayer):
    """Levels as the variants LOD0, LOD1, ... of a variant set `LOD` on the root prim; LOD0 is selected."""

    def _start(self) -> None:
        if self._root.GetVariantSets().HasVariantSet(VARIANT_SET):
            raise OptionError(f"lods: {self.path} has a variant set {VARIANT_SET} already")
        prim = define_root(self._layer, self._root)
        prim.variantSetNameList.Prepend(VARIANT_SET)
        self._set = Sdf.VariantSetSpec(prim, VARIANT_SET)
        prim.variantSelections[VARIANT_SET] = self._add(None)

    def _place(self, name: str) -> Sdf.Path:
        return Sdf.VariantSpec(self._set, name).path


class FileLevels:
    """Levels as files beside the output, each like the output of a simplification to one ratio.

    Args:
        flatten: Write self-contained files.
        other_outputs: What else is going to be written.

    Attributes:
        path: Prim that holds all meshes.
    """

    path: Sdf.Path = Sdf.Path.absoluteRootPath

    def __init__(self, flatten: bool, other_outputs: Sequence[OutputFile]) -> None:
        self._flatten, self._others = flatten, other_outputs
        self._levels: list[OverLayer] = []

    def add(self, edits: OverLayer, share: float) -> str:
        """Add the next level; see `LevelLayer.add`."""
        self._levels.append(edits)
        return f"{LEVEL_NAME}{len(self._levels)}"

    def save(self, output: Path) -> list[str]:
        """Write the files; see `OverLayer.save`."""
        problems = []
        for level, edits in enumerate(self._levels, start=1):
            problems += edits.save(Path(level_file(output, level)), self._flatten, self._others)
        return problems


def _root_prims(stage: Usd.Stage) -> list[Usd.Prim]:
    """Root prims that may hold the levels: no overs, no classes."""
    prims: list[Usd.Prim] = stage.GetPseudoRoot().GetAllChildren()
    return [prim for prim in prims if prim.IsDefined() and not prim.IsAbstract()]


def _find_root(stage: Usd.Stage) -> Usd.Prim:
    """The root prim that is to hold the levels: the default prim, or the root prim above it, or the only root prim."""
    default, roots = stage.GetDefaultPrim(), _root_prims(stage)
    if default:
        return stage.GetPrimAtPath(default.GetPath().GetPrefixes()[0])
    if len(roots) == 1:
        return roots[0]
    names = ", ".join(str(root.GetPath()) for root in roots) or "none"
    raise OptionError(f"lods: the input has no default prim, and not one root prim to hold the levels but: {names}")


def _check_targets(stage: Usd.Stage) -> None:
    """A reference to one root prim loses the targets that lie outside it."""
    for prim in Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()):
        root = prim.GetPath().GetPrefixes()[0] if not prim.IsPseudoRoot() else None
        for item in prim.GetAuthoredProperties():
            targets = item.GetTargets() if isinstance(item, Usd.Relationship) else item.GetConnections()
            for target in targets:
                if not target.HasPrefix(root):
                    raise OptionError(
                        f"lods: {item.GetPath()} refers to {target}, outside the root prim {root}; "
                        f"levels need all that a root prim refers to below it"
                    )


def define_root(layer: Sdf.Layer, prim: Usd.Prim) -> Sdf.PrimSpec:
    """A root prim on a layer with the specifier and type it has on a stage."""
    return Sdf.PrimSpec(layer, prim.GetName(), prim.GetSpecifier(), prim.GetTypeName())
