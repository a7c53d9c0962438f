"""Skins fitted to the poses of a stage."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdSkel

from tests.support.usd_skin_output import BODY, rms
from tests.support.usd_stages import FRAMES, skinned_stage
from warpqem.errors import OptionError
from warpqem.skinning.linear_skin import LinearSkin, pose_skin
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.skeleton_poses import StagePoses
from warpqem.usd.read.skin_poses import joint_transforms, shape_offsets
from warpqem.usd.write.stage_report import PrimReport


def simplified(folder: Path, **options: object) -> tuple[Usd.Stage, PrimReport]:
    report = simplify_stage(
        folder / "in.usda", folder / "out.usda", SimplifyOptions(**{"ratio": 0.4, "device": "cpu", **options})
    )
    assert report.prims[0].status == "simplified"
    # Flattened, because the next run writes the same file.
    return Usd.Stage.Open(Usd.Stage.Open(str(folder / "out.usda")).Flatten()), report.prims[0]


@pytest.mark.parametrize("order", [None, ["hip/knee", "hip"]])
def test_transforms_and_offsets_give_the_poses_of_usd_skel(order):
    stage = skinned_stage()
    if order is not None:
        UsdSkel.BindingAPI(stage.GetPrimAtPath(BODY)).CreateJointsAttr(order)
    source = MeshSource(stage.GetPrimAtPath(BODY), StagePoses(stage))
    query = source.poser.skinning_query
    joints, weights = (
        np.array(p.Get()).reshape(-1, 2) for p in (query.GetJointIndicesPrimvar(), query.GetJointWeightsPrimvar())
    )
    rest = np.array(source.mesh.GetPointsAttr().Get())
    codes = [Usd.TimeCode(time) for time in FRAMES]
    poses = pose_skin(
        LinearSkin(rest, joints, weights),
        joint_transforms(source.poser, codes),
        shape_offsets(source.poser, rest, codes),
    )
    np.testing.assert_allclose(poses, [source.points_at(time) for time in FRAMES], atol=1e-5)


def test_fitted_skin_is_nearer_than_an_interpolated_one(tmp_path):
    source = skinned_stage(tmp_path / "in.usda")
    interpolated, report = simplified(tmp_path, skin_fit=False)
    assert report.skin == "interpolated: as asked for"
    fitted, report = simplified(tmp_path)
    assert report.skin == "fitted"
    assert rms(source, fitted) < rms(source, interpolated)


def test_limit_of_influences_holds(tmp_path):
    skinned_stage(tmp_path / "in.usda")
    stage, _ = simplified(tmp_path, influences=1)
    primvar = UsdSkel.BindingAPI(stage.GetPrimAtPath(BODY)).GetJointWeightsPrimvar()
    assert primvar.GetElementSize() == 1
    assert set(primvar.Get()) == {1.0}


def test_dual_quaternion_skin_is_interpolated_and_says_why(tmp_path):
    stage = skinned_stage(tmp_path / "in.usda")
    UsdSkel.BindingAPI(stage.GetPrimAtPath(BODY)).CreateSkinningMethodAttr("dualQuaternion")
    stage.Save()
    _, report = simplified(tmp_path)
    assert report.skin == "interpolated: its skinning is not linear"


@pytest.mark.parametrize("weights", [[0.0, 0.0], [0.5, 0.3], [1.2, -0.2]])
def test_weights_that_do_not_sum_to_one_are_interpolated_and_say_so(tmp_path, weights):
    stage = skinned_stage(tmp_path / "in.usda")
    primvar = UsdSkel.BindingAPI(stage.GetPrimAtPath(BODY)).GetJointWeightsPrimvar()
    values = np.array(primvar.Get()).reshape(-1, 2)
    values[5] = weights
    primvar.Set(values.ravel().tolist())
    stage.Save()
    _, report = simplified(tmp_path)
    assert report.skin == "interpolated: its joint weights do not sum to one"


def test_weights_of_eight_bits_are_fitted(tmp_path):
    stage = skinned_stage(tmp_path / "in.usda")
    primvar = UsdSkel.BindingAPI(stage.GetPrimAtPath(BODY)).GetJointWeightsPrimvar()
    primvar.Set((np.floor(np.array(primvar.Get(), dtype=float) * 255) / 255).tolist())
    stage.Save()
    source = Usd.Stage.Open(str(tmp_path / "in.usda"))
    fitted, report = simplified(tmp_path)
    assert report.skin == "fitted"
    interpolated, _ = simplified(tmp_path, skin_fit=False)
    assert rms(source, fitted) < 1.05 * rms(source, interpolated)


def test_mesh_that_one_joint_moves_as_a_whole_has_nothing_to_fit(tmp_path):
    skinned_stage(tmp_path / "in.usda", rigid=True)
    _, report = simplified(tmp_path)
    assert report.skin is None


def test_fit_in_other_units_than_the_skeleton_is_as_near(tmp_path):
    source = skinned_stage(tmp_path / "in.usda")
    plain, _ = simplified(tmp_path)
    error = rms(source, plain)
    mesh = UsdGeom.Mesh(source.GetPrimAtPath(BODY))
    mesh.GetPointsAttr().Set([Gf.Vec3f(point * 1000) for point in mesh.GetPointsAttr().Get()])
    shape = UsdSkel.BlendShape(source.GetPrimAtPath(f"{BODY}/bulge"))
    shape.GetOffsetsAttr().Set([Gf.Vec3f(offset * 1000) for offset in shape.GetOffsetsAttr().Get()])
    half = shape.GetInbetween("half")
    half.SetOffsets([Gf.Vec3f(offset * 1000) for offset in half.GetOffsets()])
    binding = UsdSkel.BindingAPI(mesh.GetPrim())
    bind = Gf.Matrix4d().SetScale(0.001) * binding.GetGeomBindTransformAttr().Get()
    binding.GetGeomBindTransformAttr().Set(bind)
    source.Save()
    other, report = simplified(tmp_path)
    assert report.skin == "fitted"
    assert rms(source, other) < 1.1 * error


def test_example_poses_are_what_it_is_fitted_to(tmp_path):
    source = skinned_stage(tmp_path / "in.usda")
    # The same rig, turned the other way.
    clip = Usd.Stage.CreateNew(str(tmp_path / "clip.usda"))
    animation = UsdSkel.Animation.Define(clip, "/Char/Rig/Anim")
    for index, time in enumerate(FRAMES):
        turn = Gf.Rotation(Gf.Vec3d(0, 1, 0), -25.0 * index).GetQuat()
        animation.CreateRotationsAttr().Set([Gf.Quatf(1), Gf.Quatf(turn)], time)
    clip.Save()
    own, _ = simplified(tmp_path)
    stage, report = simplified(tmp_path, poses=str(tmp_path / "clip.usda"))
    assert report.skin == "fitted"
    before, after = (UsdGeom.Mesh(item.GetPrimAtPath(BODY)).GetPointsAttr().Get() for item in (own, stage))
    assert list(before) != list(after)
    assert rms(source, stage) < 5 * rms(source, own)


def test_pose_independent_simplification_is_there_to_compare_with(tmp_path):
    source = skinned_stage(tmp_path / "in.usda")
    fitted, _ = simplified(tmp_path)
    other, report = simplified(tmp_path, pose_independent=True)
    assert report.skin == "interpolated: as asked for"
    assert rms(source, fitted) < rms(source, other) < 5 * rms(source, fitted)


def test_pose_independent_simplification_excludes_what_places_points_in_poses():
    with pytest.raises(OptionError, match="pose_independent excludes"):
        SimplifyOptions(ratio=0.5, pose_independent=True, refit=True)


@pytest.mark.parametrize("way", [{}, {"skin_fit": False}, {"pose_independent": True}])
@pytest.mark.parametrize("limit", [{"max_error": 1.0}, {"max_distance": 0.1}])
def test_limits_hold_for_what_the_skin_makes_of_the_result(limit, way, tmp_path):
    skinned_stage(tmp_path / "in.usda")
    _, report = simplified(tmp_path, ratio=None, **limit, **way)
    assert report.faces_after < report.faces_before
    beyond = report.measured["hausdorff"] > limit.get("max_error", np.inf)
    # A point beyond the limit is named, and nothing else is.
    assert [problem for problem in report.problems if "not proved" in problem] or not beyond


def test_a_fitted_skin_holds_its_limit(tmp_path):
    skinned_stage(tmp_path / "in.usda")
    _, report = simplified(tmp_path, ratio=None, max_error=0.5)
    assert report.skin == "fitted"
    assert not report.problems
    assert report.measured["hausdorff"] <= 0.5


def test_a_skin_that_is_not_linear_is_proved_as_it_is_written_or_named(tmp_path):
    stage = skinned_stage(tmp_path / "in.usda")
    UsdSkel.BindingAPI(stage.GetPrimAtPath(BODY)).CreateSkinningMethodAttr("dualQuaternion")
    stage.Save()
    _, loose = simplified(tmp_path, ratio=None, max_error=20.0)
    assert not loose.problems
    _, tight = simplified(tmp_path, ratio=None, max_error=0.5)
    named = [problem for problem in tight.problems if "does not hold for the skin" in problem]
    assert len(named) == (tight.measured["hausdorff"] > 0.5)
