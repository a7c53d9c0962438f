"""Values that are no finite numbers: where they decide the result, the error names their attribute."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from tests.support.usd_stages import FRAMES, skinned_stage
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.write.stage_report import PrimReport

BODY, ANIMATION, SHAPE = "/Char/Body", "/Char/Rig/Anim", "/Char/Body/bulge"
BROKEN = [float("nan"), float("inf"), -float("inf")]
NAMES = Sdf.ValueTypeNames


def textured_stage() -> Usd.Stage:
    stage = skinned_stage()
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(BODY))
    points, corner = np.array(mesh.GetPointsAttr().Get()), np.array(mesh.GetFaceVertexIndicesAttr().Get())
    api = UsdGeom.PrimvarsAPI(mesh)
    flat = np.ascontiguousarray(points[:, :2], dtype=np.float32)
    api.CreatePrimvar("st", NAMES.TexCoord2fArray, "faceVarying").Set(Vt.Vec2fArray.FromNumpy(flat[corner]))
    api.CreatePrimvar("uv", NAMES.TexCoord2fArray, "vertex").Set(Vt.Vec2fArray.FromNumpy(flat))
    api.CreatePrimvar("heat", NAMES.DoubleArray, "vertex").Set(np.sin(points[:, 0]).astype(float).tolist())
    mesh.CreateNormalsAttr([Gf.Vec3f(0, 0, 1)] * len(points))
    mesh.SetNormalsInterpolation("vertex")
    return stage


def spoil(attribute: Usd.Attribute, value: float) -> None:
    """Break the second number of a value."""
    code = Usd.TimeCode(FRAMES[1]) if attribute.GetTimeSamples() else Usd.TimeCode.Default()
    old = attribute.Get(code)
    if isinstance(old, Vt.QuatfArray):
        attribute.Set(Vt.QuatfArray([Gf.Quatf(value, 0, 0, 0), *list(old)[1:]]), code)
        return
    array = np.array(old)
    array.flat[1] = value
    attribute.Set(Gf.Matrix4d(array.tolist()) if isinstance(old, Gf.Matrix4d) else type(old).FromNumpy(array), code)


def simplified(stage: Usd.Stage, folder: Path, **options: object) -> PrimReport:
    stage.Export(str(folder / "in.usda"))
    chosen = SimplifyOptions(**{"ratio": 0.3, "device": "cpu", **options})
    [report] = simplify_stage(folder / "in.usda", folder / "out.usda", chosen).prims
    return report


@pytest.mark.parametrize("value", BROKEN)
@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("st", {"uv_weight": 0.5}),
        ("uv", {"uv_weight": 0.5}),
        ("heat", {"attribute_weights": (("heat", 1.0),)}),
        ("heat", {"weight_primvar": "heat"}),
    ],
)
def test_primvar_that_has_a_weight_is_named(name, options, value, tmp_path):
    stage = textured_stage()
    heat = stage.GetPrimAtPath(BODY).GetAttribute("primvars:heat")
    heat.Set(np.abs(np.array(heat.Get())).tolist())
    spoil(stage.GetPrimAtPath(BODY).GetAttribute(f"primvars:{name}"), value)
    report = simplified(stage, tmp_path, **options)
    if "weight_primvar" in options and value > 0:
        # Infinity locks.
        assert report.status == "simplified"
        return
    assert report.status == "failed"
    assert f"{BODY}.primvars:{name}: " in report.message
    assert f"{value:g}" in report.message


def test_primvar_whose_values_are_too_far_apart_for_its_weight_is_named(tmp_path):
    stage = textured_stage()
    spoil(stage.GetPrimAtPath(BODY).GetAttribute("primvars:st"), 1e30)
    report = simplified(stage, tmp_path, uv_weight=0.5)
    assert report.message == (
        f"{BODY}.primvars:st: channel 1 spans 5e+29, times its weight, expected at most 1e+15, as costs are in single "
        "precision"
    )


@pytest.mark.parametrize("value", BROKEN)
@pytest.mark.parametrize(
    "path",
    [
        f"{BODY}.primvars:skel:jointWeights",
        f"{BODY}.primvars:skel:geomBindTransform",
        f"{SHAPE}.offsets",
        f"{SHAPE}.inbetweens:half",
        f"{ANIMATION}.translations",
        f"{ANIMATION}.rotations",
        f"{ANIMATION}.scales",
    ],
)
def test_value_that_breaks_a_pose_is_named(path, value, tmp_path):
    stage = textured_stage()
    spoil(stage.GetAttributeAtPath(path), value)
    report = simplified(stage, tmp_path)
    assert report.status == "failed"
    assert f"{path}: " in report.message


@pytest.mark.parametrize("attribute", ["offsets", "inbetweens:half"])
@pytest.mark.parametrize("options", [{}, {"shapes": 1}, {"morph_weights": "thirds"}])
def test_blend_shape_that_no_pose_uses_is_named(attribute, options, tmp_path):
    stage = textured_stage()
    weights = stage.GetPrimAtPath(ANIMATION).GetAttribute("blendShapeWeights")
    for time in weights.GetTimeSamples():
        weights.Set([0.0], time)
    spoil(stage.GetPrimAtPath(SHAPE).GetAttribute(attribute), float("nan"))
    report = simplified(stage, tmp_path, **options)
    assert report.status == "failed"
    assert report.message.startswith(f"{SHAPE}.{attribute}: offset 0 is")


@pytest.mark.parametrize("value", BROKEN)
def test_normal_that_is_no_number_spoils_no_other(value, tmp_path):
    stage = textured_stage()
    spoil(stage.GetPrimAtPath(BODY).GetAttribute("normals"), value)
    report = simplified(stage, tmp_path)
    assert report.status == "simplified"
    assert any(f"{BODY}.normals: value 0" in problem for problem in report.problems)
    written = Usd.Stage.Open(str(tmp_path / "out.usda"))
    assert np.isfinite(np.array(UsdGeom.Mesh(written.GetPrimAtPath(BODY)).GetNormalsAttr().Get())).all()


def test_normal_offset_that_is_no_number_is_named_and_spoils_no_fit(tmp_path):
    stage = textured_stage()
    shape = UsdSkel.BlendShape(stage.GetPrimAtPath(SHAPE))
    shape.CreateNormalOffsetsAttr([Gf.Vec3f(float("nan"), 0, 0), Gf.Vec3f(0.25, 0, 0)])
    report = simplified(stage, tmp_path)
    assert any(f"{SHAPE}.normalOffsets: value 0" in problem for problem in report.problems)
