"""A clip with poses of a stage's meshes."""

from __future__ import annotations

from pathlib import Path

import pytest
from pxr import Gf, Sdf, Usd, UsdSkel

from tests.support.usd_stages import skinned_stage


@pytest.fixture
def clip(tmp_path) -> Path:
    """Another clip of the same skeleton: five frames, in which the knee bends the other way."""
    skinned_stage(tmp_path / "in.usda")
    stage = Usd.Stage.CreateNew(str(tmp_path / "clip.usda"))
    animation = UsdSkel.Animation.Define(stage, "/Char/Rig/Anim")
    for index in range(5):
        turn = Gf.Rotation(Gf.Vec3d(0, 1, 0), -30.0 * index).GetQuat()
        animation.CreateRotationsAttr().Set([Gf.Quatf(1), Gf.Quatf(turn)], 10.0 + index)
    animation.GetPrim().GetAttribute("rotations").SetCustomDataByKey("clip", "other")
    for name, values in (("translations", [(0, 0, 0), (4, 0, 0)]), ("scales", [(1, 1, 1), (1, 1, 1)])):
        kind = Sdf.ValueTypeNames.Float3Array if name == "translations" else Sdf.ValueTypeNames.Half3Array
        animation.GetPrim().CreateAttribute(name, kind).Set(values, 10.0)
    animation.CreateBlendShapeWeightsAttr().Set([0.0], 10.0)
    stage.Save()
    return tmp_path / "clip.usda"
