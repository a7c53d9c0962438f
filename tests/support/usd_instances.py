"""Stages with instances of other files and variants."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Sdf, Usd, UsdGeom, Vt

from tests.support.usd_stages import cloth_stage


def faces_at(stage: Usd.Stage, path: str) -> int:
    return len(UsdGeom.Mesh(stage.GetPrimAtPath(path)).GetFaceVertexCountsAttr().Get())


def instance(stage: Usd.Stage, path: str, file: str = "", prim: str = "") -> Usd.Prim:
    made = stage.DefinePrim(path)
    made.GetReferences().AddReference(file, prim) if prim else made.GetReferences().AddReference(file)
    made.SetInstanceable(True)
    return made


def tile_file(path: Path) -> None:
    """A cloth with texture coordinates and a subset, below a default prim."""
    stage = cloth_stage(path)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth"))
    values = np.linspace(0, 1, 81, dtype=np.float32)
    st = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, "vertex")
    st.Set(Vt.Vec2fArray.FromNumpy(np.stack([values, values], axis=1)))
    UsdGeom.Subset.CreateGeomSubset(mesh, "half", "face", list(range(32)))
    stage.Save()


def scene_of(tmp_path: Path) -> Usd.Stage:
    tile_file(tmp_path / "tile.usda")
    stage = Usd.Stage.CreateNew(str(tmp_path / "in.usda"))
    for name in ("First", "Second"):
        instance(stage, f"/Set/{name}", "./tile.usda")
    stage.Save()
    return stage
