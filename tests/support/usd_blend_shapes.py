"""Stages with blend shapes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdSkel

from tests.support.usd_stages import skinned_stage

BODY = "/Char/Body"


SHAPE = f"{BODY}/bulge"


def shaped_stage(folder: Path) -> Usd.Stage:
    """A skinned cloth whose blend shape lifts the half with x below 4 by x, with normals and an inbetween."""
    stage = skinned_stage(folder / "in.usda")
    points = np.array(UsdGeom.Mesh(stage.GetPrimAtPath(BODY)).GetPointsAttr().Get())
    lift = [Gf.Vec3f(0, 0, 4 - float(x)) if x < 4 else Gf.Vec3f(0) for x in points[:, 0]]
    shape = UsdSkel.BlendShape(stage.GetPrimAtPath(SHAPE))
    shape.GetPointIndicesAttr().Set([])
    shape.GetOffsetsAttr().Set(lift)
    shape.CreateNormalOffsetsAttr([vector * 0.1 for vector in lift])
    shape.GetInbetween("half").SetOffsets([vector * 0.7 for vector in lift])
    stage.Save()
    return stage
