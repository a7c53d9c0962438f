"""The files that a simplification writes, by its options. No stage is needed for it, nor USD."""

from __future__ import annotations

import os
from pathlib import Path

from warpqem.usd.commands.simplify_options import SimplifyOptions

__all__ = ["LEVEL_NAME", "VARIANT_SET", "level_file", "output_files"]

# Levels count up from the original.
LEVEL_NAME = "LOD"
# The variant set that usdview, Omniverse and others show for levels of detail, or the prim of UsdLod.
VARIANT_SET = "LOD"


def level_file(output: str | os.PathLike[str], level: int) -> str:
    """The file of one level, such as shots/hero_LOD1.usdc for shots/hero.usdc."""
    path = Path(output)
    return os.fspath(path.with_name(f"{path.stem}_{LEVEL_NAME}{level}{path.suffix}"))


def output_files(output: str | os.PathLike[str], options: SimplifyOptions) -> list[str]:
    """All files that are going to be written for an output, but for the textures of a flat one."""
    if not options.lod_files:
        return [os.fspath(output)]
    return [level_file(output, level) for level in range(1, len(options.lods) + 1)]
