"""The levels of detail of a file as stages, on which every mesh has the path that it has on the original."""

from __future__ import annotations

import os
import re

from pxr import Sdf, Usd

from warpqem.errors import OptionError
from warpqem.usd.commands.output_names import LEVEL_NAME, VARIANT_SET
from warpqem.usd.read.open_stage import open_stage
from warpqem.usd.read.stage_views import copy_stage_metadata

__all__ = ["ORIGINAL", "level_names", "level_root", "level_stages", "original_of_levels"]

# The finest level, which is the original.
ORIGINAL = f"{LEVEL_NAME}0"


def level_names(stage: Usd.Stage) -> list[str]:
    """Names of the levels of detail on a stage, the finest first; empty if it has none.

    Those of the default prim, or of the first root prim that has levels.
    """
    root = level_root(stage)
    return [] if root is None else _levels_at(root)


def level_root(stage: Usd.Stage) -> Usd.Prim | None:
    """The default prim if it has levels, or the first root prim that has; None without one."""
    roots = [stage.GetDefaultPrim(), *stage.GetPseudoRoot().GetChildren()]
    return next((prim for prim in roots if prim and _levels_at(prim)), None)


def _levels_at(root: Usd.Prim) -> list[str]:
    names: list[str] = root.GetVariantSets().GetVariantSet(VARIANT_SET).GetVariantNames()
    if not names:
        holder = root.GetChild(VARIANT_SET)
        names = [prim.GetName() for prim in holder.GetChildren()] if holder else []
    names = [name for name in names if re.fullmatch(rf"{LEVEL_NAME}\d+", name)]
    return sorted(names, key=lambda name: int(name.removeprefix(LEVEL_NAME)))


def level_stages(path: str | os.PathLike[str]) -> list[tuple[str, Usd.Stage]]:
    """Name and stage of each level below the original, as variants or prims of UsdLod.

    Args:
        path: USD file with levels, as `warpqem simplify --lods` writes them.

    Raises:
        StageError: the file cannot be read.
        OptionError: it has no levels.
    """
    names = [name for name in level_names(open_stage(path)) if name != ORIGINAL]
    if not names:
        raise OptionError(
            f"{path}: has no levels of detail: no variants or prims {LEVEL_NAME}1, {LEVEL_NAME}2, ... in a variant set "
            f"or prim {VARIANT_SET!r} of a root prim"
        )
    return [(name, _level_stage(path, name)) for name in names]


def original_of_levels(path: str | os.PathLike[str], stage: Usd.Stage) -> Usd.Stage | None:
    """The original alone of a file whose levels are prims of UsdLod; None for other files.

    What does not know UsdLod would show all levels at once, while of levels that are variants it shows the original.

    Args:
        path: USD file.
        stage: The same file, open.
    """
    root = level_root(stage)
    if root is None or root.GetVariantSets().HasVariantSet(VARIANT_SET):
        return None
    return _level_stage(path, ORIGINAL)


def _level_stage(path: str | os.PathLike[str], name: str) -> Usd.Stage:
    stage = open_stage(path)
    roots = [root for root in stage.GetPseudoRoot().GetChildren() if name in _levels_at(root)]
    inner = [root for root in roots if not root.GetVariantSets().HasVariantSet(VARIANT_SET)]
    with Usd.EditContext(stage, stage.GetSessionLayer()):
        for root in roots:
            if root not in inner:
                root.GetVariantSet(VARIANT_SET).SetVariantSelection(name)
    if not inner:
        return stage
    # A level of UsdLod lies two prims deeper than the original.
    source = stage.GetRootLayer()
    layer = Sdf.Layer.CreateAnonymous("level.usda")
    copy_stage_metadata(source, layer)
    for root in inner:
        prim = Sdf.PrimSpec(layer, root.GetName(), Sdf.SpecifierDef, root.GetTypeName())
        place = root.GetPath().AppendChild(VARIANT_SET).AppendChild(name)
        prim.referenceList.Prepend(Sdf.Reference(source.identifier, place))
    return Usd.Stage.Open(layer)
