"""Fewer blend shapes for the meshes of a stage."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdSkel, Vt

from tests.support.cli import run
from tests.support.usd_rig import ANIMATION, FRAMES, SHAPES, SKELETON, TUBE, rms, shaped_rig
from warpqem.errors import OptionError
from warpqem.usd import FrameRange, SimplifyOptions, simplify_stage
from warpqem.usd.write.stage_report import PrimReport, StageReport


def simplified(folder: Path, **options: object) -> tuple[Usd.Stage, PrimReport]:
    report = reported(folder, **options)
    # Flattened, because the next run writes the same file.
    return Usd.Stage.Open(Usd.Stage.Open(str(folder / "out.usda")).Flatten()), report.prims[0]


def reported(folder: Path, **options: object) -> StageReport:
    chosen = SimplifyOptions(**{"ratio": 0.2, "device": "cpu", **options})
    report = simplify_stage(folder / "in.usda", folder / "out.usda", chosen)
    assert {prim.status for prim in report.prims} == {"simplified"}
    return report


def weights(stage: Usd.Stage) -> np.ndarray:
    attribute = UsdSkel.Animation(stage.GetPrimAtPath(ANIMATION)).GetBlendShapeWeightsAttr()
    return np.array([attribute.Get(frame) for frame in FRAMES])


def test_shape_of_nothing_and_a_sum_of_others_go(tmp_path):
    shaped_rig(tmp_path / "in.usda")
    stage, report = simplified(tmp_path, shapes=2)
    assert report.shapes.removed == ["nothing", "both"]
    assert (report.shapes.before, report.shapes.after) == (4, 2)
    assert report.shapes.merged["both"] == pytest.approx({"left": 1.0, "right": 1.0}, abs=0.02)
    binding = UsdSkel.BindingAPI(stage.GetPrimAtPath(TUBE))
    assert list(binding.GetBlendShapesAttr().Get()) == ["left", "right"]
    assert [path.name for path in binding.GetBlendShapeTargetsRel().GetTargets()] == ["left", "right"]
    assert not stage.GetPrimAtPath(f"{TUBE}/both")


def test_animation_goes_on_with_corrected_weights(tmp_path):
    source = shaped_rig(tmp_path / "in.usda")
    stage, report = simplified(tmp_path, shapes=2)
    before, after = weights(source), weights(stage)
    parts = report.shapes.merged["both"]
    np.testing.assert_allclose(after[:, 0], before[:, 0] + parts["left"] * before[:, 2], atol=1e-5)
    np.testing.assert_array_equal(after[:, 2:], before[:, 2:])
    assert (after <= 1).all()
    plain, _ = simplified(tmp_path)
    assert rms(source, stage) < 1.05 * rms(source, plain)
    assert rms(source, stage) == pytest.approx(report.measured["rms"], rel=0.15)


@pytest.mark.parametrize("value", [Sdf.ValueBlock(), [], [0.1, 0.2, 0.3], [0.1]], ids=["block", "empty", "3", "1"])
def test_weights_that_are_missing_at_a_sample_are_zero(tmp_path, value):
    source = shaped_rig(tmp_path / "in.usda")
    UsdSkel.Animation(source.GetPrimAtPath(ANIMATION)).GetBlendShapeWeightsAttr().Set(value, 2)
    source.Save()
    stage, report = simplified(tmp_path, shapes=2)
    part = report.shapes.merged["both"]["left"]
    attribute = UsdSkel.Animation(stage.GetPrimAtPath(ANIMATION)).GetBlendShapeWeightsAttr()
    given = [] if isinstance(value, Sdf.ValueBlock) else value
    both = given[2] if len(given) > 2 else 0.0
    expected = [given[0] + part * both] if given else []
    np.testing.assert_allclose(list(attribute.Get(2) or [])[:1], expected, atol=1e-6)
    assert attribute.Get(3)[0] > 0


def test_weight_that_is_no_number_is_named(tmp_path):
    source = shaped_rig(tmp_path / "in.usda")
    values = [0.1, float("nan"), 0.2, 0.3]
    UsdSkel.Animation(source.GetPrimAtPath(ANIMATION)).GetBlendShapeWeightsAttr().Set(values, 9)
    source.Save()
    chosen = SimplifyOptions(ratio=0.2, device="cpu", shapes=2, frames=FrameRange(1, 4))
    [mesh] = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", chosen).prims
    assert mesh.status == "failed"
    assert f"{ANIMATION}.blendShapeWeights: nan at time 9.0 is not a finite number" in mesh.message


def test_animation_without_weights_or_names_of_shapes_moves_none(tmp_path):
    source = shaped_rig(tmp_path / "in.usda")
    animation = UsdSkel.Animation(source.GetPrimAtPath(ANIMATION))
    animation.GetBlendShapesAttr().Set([])
    source.Save()
    _, report = simplified(tmp_path, shapes=2)
    assert report.shapes.used_error == 0
    animation.GetBlendShapesAttr().Set(SHAPES)
    animation.GetPrim().RemoveProperty("blendShapeWeights")
    source.Save()
    stage, report = simplified(tmp_path, shapes=2)
    assert report.shapes.used_error == 0
    assert not UsdSkel.Animation(stage.GetPrimAtPath(ANIMATION)).GetBlendShapeWeightsAttr().HasAuthoredValue()


def test_limit_on_the_error_takes_what_nothing_shows_and_what_others_show(tmp_path):
    shaped_rig(tmp_path / "in.usda")
    _, report = simplified(tmp_path, shape_error=1e-3)
    assert report.shapes.removed == ["nothing", "both"]
    assert report.shapes.scales == pytest.approx({"left": 2.0, "right": 2.0}, rel=0.02)
    assert report.shapes.random_error <= 1e-3


@pytest.mark.parametrize("inbetween", [False, True])
def test_shape_that_moves_only_normals_stays(tmp_path, inbetween):
    source = shaped_rig(tmp_path / "in.usda")
    shape = UsdSkel.BlendShape(source.GetPrimAtPath(f"{TUBE}/nothing"))
    offsets = shape.GetOffsetsAttr().Get()
    turned = Vt.Vec3fArray([(0.3, 0, 0)] * len(offsets))
    if inbetween:
        half = shape.CreateInbetween("half")
        half.SetWeight(0.5)
        half.SetOffsets(offsets)
        half.CreateNormalOffsetsAttr(turned)
    else:
        shape.CreateNormalOffsetsAttr(turned)
    source.Save()
    _, report = simplified(tmp_path, shapes=2)
    assert "nothing" not in report.shapes.removed
    assert f"{TUBE}: these blend shapes move only normals, and stay: nothing" in report.notes


def test_weights_that_another_mesh_uses_stay(tmp_path):
    source = shaped_rig(tmp_path / "in.usda", meshes=2)
    report = reported(tmp_path, shapes=2)
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    np.testing.assert_array_equal(weights(stage), weights(source))
    assert all(prim.shapes.merged == {} for prim in report.prims)


def check_weights_stay(folder: Path, source: Usd.Stage) -> None:
    report = reported(folder, shapes=2, prims=(TUBE,))
    stage = Usd.Stage.Open(str(folder / "out.usda"))
    np.testing.assert_array_equal(weights(stage), weights(source))
    [mesh] = report.prims
    assert (mesh.shapes.after, mesh.shapes.merged) == (2, {})
    named = f"{TUBE}: the weights of left, right, both, nothing in {ANIMATION} stay"
    assert any(note.startswith(named) for note in mesh.notes)


def test_weights_that_a_mesh_of_an_instance_uses_stay(tmp_path):
    source = shaped_rig(tmp_path / "in.usda", meshes=2)
    layer = source.GetRootLayer()
    UsdGeom.Xform.Define(source, "/Library")
    Sdf.CopySpec(layer, f"{TUBE}1", layer, "/Library/Mesh")
    targets = [f"/Library/Mesh/{token}" for token in SHAPES]
    UsdSkel.BindingAPI(source.GetPrimAtPath("/Library/Mesh")).GetBlendShapeTargetsRel().SetTargets(targets)
    UsdSkel.BindingAPI(source.GetPrimAtPath("/Library/Mesh")).GetSkeletonRel().ClearTargets(True)
    source.RemovePrim(f"{TUBE}1")
    instance = UsdGeom.Xform.Define(source, "/Char/Instance").GetPrim()
    UsdSkel.BindingAPI.Apply(instance).CreateSkeletonRel().SetTargets([SKELETON])
    instance.GetReferences().AddInternalReference("/Library")
    instance.SetInstanceable(True)
    source.Save()
    check_weights_stay(tmp_path, source)


@pytest.mark.parametrize("in_file", [False, True])
def test_weights_that_a_mesh_of_an_unselected_variant_uses_stay(tmp_path, in_file):
    source = shaped_rig(tmp_path / "in.usda", meshes=2)
    layer = source.GetRootLayer()
    variants = source.GetPrimAtPath("/Char").GetVariantSets().AddVariantSet("look")
    for name in ("plain", "rich"):
        variants.AddVariant(name)
    if in_file:
        part = Sdf.Layer.CreateNew(str(tmp_path / "part.usda"))
        Sdf.CopySpec(layer, f"{TUBE}1", part, "/Mesh")
        part.Save()
        variants.SetVariantSelection("rich")
        with variants.GetVariantEditContext():
            source.DefinePrim("/Char/More").GetReferences().AddReference("./part.usda", "/Mesh")
    else:
        Sdf.CopySpec(layer, f"{TUBE}1", layer, "/Char{look=rich}Tube1")
    source.RemovePrim(f"{TUBE}1")
    variants.SetVariantSelection("plain")
    source.Save()
    check_weights_stay(tmp_path, source)


def test_mesh_in_a_selected_variant_is_no_other(tmp_path):
    source = shaped_rig(tmp_path / "in.usda")
    layer = source.GetRootLayer()
    variants = source.GetPrimAtPath("/Char").GetVariantSets().AddVariantSet("look")
    variants.AddVariant("plain")
    Sdf.CopySpec(layer, TUBE, layer, "/Char{look=plain}Tube")
    source.RemovePrim(TUBE)
    variants.SetVariantSelection("plain")
    source.Save()
    report = reported(tmp_path, shapes=2)
    assert list(report.prims[0].shapes.merged) == ["both"]


def test_each_level_has_its_own_number_of_shapes_and_weights(tmp_path):
    source = shaped_rig(tmp_path / "in.usda")
    report = reported(tmp_path, ratio=None, lods=(0.4, 0.2), shapes=(3, 2))
    assert [prim.shapes.after for prim in report.prims] == [3, 2]
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    variants = stage.GetDefaultPrim().GetVariantSet("LOD")
    np.testing.assert_array_equal(weights(stage), weights(source))
    variants.SetVariantSelection("LOD2")
    assert not np.array_equal(weights(stage), weights(source))
    assert list(UsdSkel.BindingAPI(stage.GetPrimAtPath(TUBE)).GetBlendShapesAttr().Get()) == ["left", "right"]


def test_joints_and_shapes_go_together(tmp_path):
    source = shaped_rig(tmp_path / "in.usda")
    stage, report = simplified(tmp_path, shapes=2, joints=4)
    assert (report.shapes.after, report.joints.after) == (2, 4)
    plain, _ = simplified(tmp_path)
    assert rms(source, stage) < 1.1 * rms(source, plain)


def test_table_names_the_shapes_that_went(tmp_path):
    shaped_rig(tmp_path / "in.usda")
    files = (str(tmp_path / "in.usda"), "-o", str(tmp_path / "out.usda"))
    shown = run("simplify", *files, "--ratio", "0.2", "--shapes", "2", "--device", "cpu")
    assert shown.exit_code == 0
    assert "2 of 4" in shown.output
    assert "without the blend shapes nothing, both; 1 of them go on in others" in " ".join(shown.output.split())


def test_baked_shapes_cannot_go():
    with pytest.raises(OptionError, match="shapes and shape_error exclude bake"):
        SimplifyOptions(ratio=0.2, shapes=2, bake=True)


def test_shapes_without_an_animation_are_chosen_by_random_weights(tmp_path):
    stage = shaped_rig(tmp_path / "in.usda")
    stage.RemovePrim(ANIMATION)
    stage.Save()
    _, report = simplified(tmp_path, shapes=2)
    assert report.shapes.removed == ["nothing", "both"]
    assert report.shapes.used_error == 0
    text = "nothing animates its blend shapes, so that random weights alone decide which go"
    assert report.notes == [f"{TUBE}: {text}"]


@pytest.mark.parametrize("animated", [False, True])
def test_equal_shapes_merge_within_a_small_limit(animated, tmp_path):
    source = shaped_rig(tmp_path / "in.usda")
    same = UsdSkel.BlendShape(source.GetPrimAtPath(f"{TUBE}/left")).GetOffsetsAttr().Get()
    for token in SHAPES:
        UsdSkel.BlendShape(source.GetPrimAtPath(f"{TUBE}/{token}")).GetOffsetsAttr().Set(same)
    if not animated:
        source.RemovePrim(ANIMATION)
    source.Save()
    stage, report = simplified(tmp_path, shape_error=0.01)
    assert report.shapes.after == 1
    assert max(report.shapes.used_error, report.shapes.random_error) <= 0.01
    [(kept, scale)] = report.shapes.scales.items()
    assert scale == pytest.approx(4.0, rel=1e-4)
    assert any(f"the offsets of blend shape {kept} are 4 times as long" in note for note in report.notes)
    plain, _ = simplified(tmp_path)
    longest = [
        np.abs(UsdSkel.BlendShape(each.GetPrimAtPath(f"{TUBE}/{kept}")).GetOffsetsAttr().Get()).max()
        for each in (plain, stage)
    ]
    assert longest[1] == pytest.approx(scale * longest[0], rel=1e-4)
    if animated:
        np.testing.assert_allclose(
            weights(stage)[:, SHAPES.index(kept)], weights(source).sum(axis=1) / scale, atol=1e-4
        )
        assert rms(source, stage) < 1.02 * rms(source, plain)
        assert rms(source, stage) == pytest.approx(report.measured["rms"], rel=0.15)


def test_equal_shapes_with_inbetweens_or_other_users_stay_as_they_are(tmp_path):
    source = shaped_rig(tmp_path / "in.usda")
    same = UsdSkel.BlendShape(source.GetPrimAtPath(f"{TUBE}/left")).GetOffsetsAttr().Get()
    for token in SHAPES:
        shape = UsdSkel.BlendShape(source.GetPrimAtPath(f"{TUBE}/{token}"))
        shape.GetOffsetsAttr().Set(same)
        # Beyond the ends, where it takes part in no sum.
        between = shape.CreateInbetween("more")
        between.SetWeight(1.5)
        between.SetOffsets(same)
    source.Save()
    _, report = simplified(tmp_path, shape_error=0.01)
    assert (report.shapes.after, report.shapes.scales) == (4, {})
