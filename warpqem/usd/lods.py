"""Levels of detail of one file as the variants of its default prim."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pxr import Sdf, Usd

from warpqem.errors import OptionError, StageError
from warpqem.usd.report import PrimReport
from warpqem.usd.stage import find_meshes
from warpqem.usd.write import OverLayer, copy_stage_metadata, export_layer, relative_path

__all__ = ["LevelLayer", "LevelReport", "check_lods", "parse_lods"]

# The name that usdview, Omniverse and others show for levels of detail; its variants count up from the original.
VARIANT_SET = "LOD"


def parse_lods(text: str) -> tuple[float, ...]:
    """Read ratios such as "0.5,0.25,0.1".

    Raises:
        OptionError: one of them is no number.
    """
    ratios = []
    for part in text.split(","):
        try:
            ratios.append(float(part))
        except ValueError:
            raise OptionError(f"lods '{text}': '{part}' is no number; expected ratios such as 0.5,0.25,0.1") from None
    return tuple(ratios)


def check_lods(ratios: Sequence[float]) -> None:
    """Check the ratios of the levels below the original.

    Raises:
        OptionError: one is not between 0 and 1, or not smaller than the one before it.
    """
    before = math.inf
    for ratio in ratios:
        if not 0 < ratio < 1:
            raise OptionError(f"lods: ratio {ratio:g}: expected a share above 0 and below 1")
        if ratio >= before:
            raise OptionError(f"lods: ratio {ratio:g} after {before:g}: each level must be smaller than the one before")
        before = ratio


@dataclass
class LevelReport(PrimReport):
    """The outcome for one mesh on one level.

    Attributes:
        level: Name of the variant.
    """

    level: str = ""


class LevelLayer:
    """A layer that shows an input file with a choice of levels, kept in memory until saved.

    The root prim that holds the default prim of the input gets the variant set `LOD`. Every variant references the
    input, and all but LOD0 hold edits over it. The input is no sublayer, as its opinions would then be local ones,
    which are stronger than those of a variant. Other root prims are references to those of the input.
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
        wrapper = _find_wrapper(source)
        self._path = wrapper.GetPath()
        self._check_meshes(source, prim_paths)
        _check_targets(source)
        self._layer = Sdf.Layer.CreateAnonymous("levels.usda")
        copy_stage_metadata(self._source, self._layer)
        self._layer.defaultPrim = wrapper.GetName()
        prim = _define(self._layer, wrapper)
        for other in source.GetPseudoRoot().GetAllChildren():
            if other != wrapper and other.HasDefiningSpecifier():
                self._reference(_define(self._layer, other), other.GetPath())
        prim.variantSetNameList.Prepend(VARIANT_SET)
        self._set = Sdf.VariantSetSpec(prim, VARIANT_SET)
        self._names: list[str] = []
        self._reference(self._add_variant().primSpec, self._path)
        prim.variantSelections[VARIANT_SET] = self._names[0]

    def add(self, edits: OverLayer) -> str:
        """Add the next level.

        Args:
            edits: Edits over the input, all below the prim that holds the levels.

        Returns:
            The name of its variant.

        Raises:
            StageError: USD cannot copy the edits.
        """
        variant = self._add_variant()
        if edits.layer.GetPrimAtPath(self._path) and not Sdf.CopySpec(
            edits.layer, self._path, self._layer, variant.path
        ):
            raise StageError(f"{self._path}: USD cannot copy the edits of {variant.name} into a variant")
        self._reference(variant.primSpec, self._path)
        return variant.name

    def save(self, output: Path) -> None:
        """Write the layer under a temporary name and rename it.

        Args:
            output: Path checked with `check_output_path`.

        Raises:
            StageError: the file cannot be written; nothing is left behind.
        """
        # A copy, because an anonymous layer that a stage is open on cannot resolve a relative path.
        layer = Sdf.Layer.CreateAnonymous("save.usda")
        layer.TransferContent(self._layer)
        layer.UpdateCompositionAssetDependency(
            self._source.realPath, relative_path(self._source.realPath, output.parent)
        )
        export_layer(layer, output)

    def _add_variant(self) -> Sdf.VariantSpec:
        self._names.append(f"{VARIANT_SET}{len(self._names)}")
        return Sdf.VariantSpec(self._set, self._names[-1])

    def _reference(self, prim: Sdf.PrimSpec, path: Sdf.Path) -> None:
        prim.referenceList.Prepend(Sdf.Reference(self._source.realPath, path))

    def _check_meshes(self, source: Usd.Stage, prim_paths: Sequence[str]) -> None:
        selection = find_meshes(source, prim_paths)
        paths = [prim.GetPath() for prim in selection.prims] + [Sdf.Path(path) for path, _error in selection.refused]
        for path in paths:
            if not path.HasPrefix(self._path):
                raise OptionError(
                    f"lods: the mesh {path} is outside {self._path}, the root prim that holds the levels; "
                    f"move it there, or take other meshes only with --prim"
                )


def _root_prims(stage: Usd.Stage) -> list[Usd.Prim]:
    """Root prims that may hold the levels: no overs, no classes."""
    prims: list[Usd.Prim] = stage.GetPseudoRoot().GetAllChildren()
    return [prim for prim in prims if prim.IsDefined() and not prim.IsAbstract()]


def _find_wrapper(stage: Usd.Stage) -> Usd.Prim:
    """The root prim that is to hold the levels: the default prim, or the root prim above it, or the only root prim."""
    default, roots = stage.GetDefaultPrim(), _root_prims(stage)
    if default:
        prim = stage.GetPrimAtPath(default.GetPath().GetPrefixes()[0])
    elif len(roots) == 1:
        prim = roots[0]
    else:
        names = ", ".join(str(root.GetPath()) for root in roots) or "none"
        raise OptionError(f"lods: the input has no default prim, and not one root prim to hold the levels but: {names}")
    if prim.GetVariantSets().HasVariantSet(VARIANT_SET):
        raise OptionError(f"lods: {prim.GetPath()} has a variant set {VARIANT_SET} already")
    return prim


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


def _define(layer: Sdf.Layer, prim: Usd.Prim) -> Sdf.PrimSpec:
    return Sdf.PrimSpec(layer, prim.GetName(), prim.GetSpecifier(), prim.GetTypeName())
