"""Stages with many point samples, and blocks that are small."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom

from tests.support.rich_stage import rich_stage
from tests.support.usd_stages import cloth_stage, skinned_stage
from warpqem.usd import SimplifyOptions, simplify_stage

TIMES = [float(time) for time in range(21)]


CLOTH, BODY = "/Root/Cloth", "/Char/Body"


def split_cloth(path: Path) -> Usd.Stage:
    """A cloth whose every triangle has points of its own."""
    stage = cloth_stage(path, times=TIMES, triangles=True)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH))
    indices = np.asarray(mesh.GetFaceVertexIndicesAttr().Get())
    for time in TIMES:
        mesh.GetPointsAttr().Set(np.asarray(mesh.GetPointsAttr().Get(time))[indices], time)
    mesh.GetFaceVertexIndicesAttr().Set(np.arange(len(indices), dtype=np.int32))
    stage.Save()
    return stage


def smooth_cloth(path: Path) -> Usd.Stage:
    """A cloth that gets normals because it was smooth by subdivision."""
    stage = cloth_stage(path, times=TIMES)
    UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)).GetSubdivisionSchemeAttr().Set("catmullClark")
    stage.Save()
    return stage


STAGES = {
    "cache": (lambda path: cloth_stage(path, times=TIMES), {}),
    "welded": (split_cloth, {}),
    "smooth": (smooth_cloth, {}),
    "skinned": (skinned_stage, {}),
    "baked": (skinned_stage, {"bake": True}),
    "flat": (lambda path: cloth_stage(path, times=TIMES), {"flatten": True}),
    "levels": (lambda path: cloth_stage(path, times=TIMES), {"ratio": None, "lods": (0.5, 0.2)}),
    "refit": (lambda path: cloth_stage(path, times=TIMES), {"refit": True}),
    "rich": (rich_stage, {}),
    "rich levels": (rich_stage, {"ratio": None, "lods": (0.5, 0.2)}),
    "aqem": (lambda path: cloth_stage(path, times=TIMES), {"metric": "aqem"}),
}


@pytest.fixture
def in_small_blocks(monkeypatch):
    """Nothing is kept between reads, blocks are as small as they can be, and every sample is saved at once."""

    def shrink() -> None:
        monkeypatch.setattr("warpqem.usd.commands.mesh_job.KEPT_BYTES", 0)
        monkeypatch.setattr("warpqem.frames.blocks.BLOCK_BYTES", 1)
        monkeypatch.setattr("warpqem.pipeline.memory_plan.BLOCK_BYTES", 1)
        monkeypatch.setattr("warpqem.usd.layers.sample_saver.UNSAVED_BYTES", 1)
        monkeypatch.setattr("warpqem.usd.layers.sample_saver.TABLE_SHARE", 0)

    return shrink


def simplify(folder: Path, name: str, **options: object) -> Usd.Stage:
    options = {"ratio": 0.3, "device": "cpu"} | options
    report = simplify_stage(folder / "in.usda", folder / name, SimplifyOptions(**options))
    assert [prim.status for prim in report.prims] == ["simplified"] * len(report.prims)
    return Usd.Stage.Open(str(folder / name))


def text_of(path: Path) -> str:
    """All that a layer says."""
    layer = Sdf.Layer.FindOrOpen(str(path))
    return layer.ExportToString()


def written(folder: Path, name: str, **options: object) -> str:
    simplify(folder, name, **options)
    return text_of(folder / name)
