"""Skeletons without the joints that no mesh uses any more."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdSkel, Vt

from tests.support.usd_rig import ANIMATION, NAMES, SKELETON, TUBE, baked, rig
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.write.skeleton_output import reduce_skeletons


def simplified(folder: Path, **options: object) -> tuple[Usd.Stage, list[str]]:
    chosen = SimplifyOptions(**{"ratio": 0.2, "device": "cpu", **options})
    report = simplify_stage(folder / "in.usda", folder / "out.usda", chosen)
    # Flattened, because the next run writes the same file.
    return Usd.Stage.Open(Usd.Stage.Open(str(folder / "out.usda")).Flatten()), report.notes


def joints(stage: Usd.Stage) -> list[list[str]]:
    skeleton, animation = (stage.GetPrimAtPath(path) for path in (SKELETON, ANIMATION))
    return [list(prim.GetAttribute("joints").Get()) for prim in (skeleton, animation)]


def test_poses_are_those_with_the_whole_skeleton(tmp_path):
    rig(tmp_path / "in.usda")
    whole, _ = simplified(tmp_path, joints=2)
    reduced, notes = simplified(tmp_path, joints=2, reduce_skeleton=True)
    assert notes == [f"{SKELETON}: 2 of 5 joints stay"]
    skeleton, animation = joints(reduced)
    assert skeleton == animation
    assert set(skeleton) == set(UsdSkel.BindingAPI(reduced.GetPrimAtPath(TUBE)).GetJointsAttr().Get())
    for name in ("bindTransforms", "restTransforms"):
        assert len(reduced.GetPrimAtPath(SKELETON).GetAttribute(name).Get()) == 2
    np.testing.assert_allclose(baked(reduced)[0], baked(whole)[0], atol=1e-5)


def test_joints_that_another_mesh_uses_stay(tmp_path):
    rig(tmp_path / "in.usda", meshes=2)
    reduced, _ = simplified(tmp_path, joints=2, reduce_skeleton=True, prims=(TUBE,))
    assert joints(reduced)[0] == list(NAMES)
    plain, _ = simplified(tmp_path, joints=2, prims=(TUBE,))
    np.testing.assert_allclose(baked(reduced, TUBE + "1")[0], baked(plain, TUBE + "1")[0], atol=1e-5)


def test_mesh_that_counts_through_the_skeleton_gets_an_order_of_its_own(tmp_path):
    stage = rig(tmp_path / "in.usda", meshes=2)
    other = UsdSkel.BindingAPI(stage.GetPrimAtPath(TUBE + "1"))
    other.CreateJointIndicesPrimvar(True, 1).Set([3])
    other.CreateJointWeightsPrimvar(True, 1).Set([1.0])
    stage.Save()
    before = baked(stage, TUBE + "1")[0]
    reduced, notes = simplified(tmp_path, joints=1, reduce_skeleton=True, prims=(TUBE,))
    assert "a/b/c/d" in joints(reduced)[0]
    assert len(joints(reduced)[0]) <= 2 == len(NAMES) - 3
    assert len(notes) == 1
    np.testing.assert_allclose(baked(reduced, TUBE + "1")[0], before, atol=1e-5)


def test_each_level_has_its_own_skeleton(tmp_path):
    rig(tmp_path / "in.usda")
    options = SimplifyOptions(lods=(0.4, 0.2), joints=(4, 2), reduce_skeleton=True, device="cpu")
    simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options)
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    variants = stage.GetDefaultPrim().GetVariantSet("LOD")
    for level, count in enumerate((5, 4, 2)):
        variants.SetVariantSelection(f"LOD{level}")
        assert [len(names) for names in joints(stage)] == [count, count]


def test_joint_above_stays_where_transforms_do_not_compose(tmp_path):
    # A turn between two uneven scales is a shear.
    stage = rig(tmp_path / "in.usda")
    animation = UsdSkel.Animation(stage.GetPrimAtPath(ANIMATION))
    animation.GetScalesAttr().Set([Gf.Vec3h(1, 1, 1), Gf.Vec3h(3, 1, 1), *[Gf.Vec3h(1, 1, 1)] * 3])
    binding = UsdSkel.BindingAPI(stage.GetPrimAtPath(TUBE))
    binding.GetJointIndicesPrimvar().Set([0, 2, 0] * (len(binding.GetJointIndicesPrimvar().Get()) // 3))
    before = baked(stage)[0]
    assert reduce_skeletons(stage) == [f"{SKELETON}: 3 of 5 joints stay"]
    assert joints(stage)[0] == ["a", "a/b", "a/b/c"]
    np.testing.assert_allclose(baked(stage)[0], before, atol=2e-3)


def test_animation_of_two_skeletons_keeps_both_whole(tmp_path):
    stage = rig(tmp_path / "in.usda", meshes=2)
    second = UsdSkel.Skeleton.Define(stage, "/Char/Second")
    first = UsdSkel.Skeleton(stage.GetPrimAtPath(SKELETON))
    for name in ("joints", "bindTransforms", "restTransforms"):
        second.GetPrim().GetAttribute(name).Set(first.GetPrim().GetAttribute(name).Get())
    UsdSkel.BindingAPI.Apply(second.GetPrim()).CreateAnimationSourceRel().SetTargets([ANIMATION])
    UsdSkel.BindingAPI(stage.GetPrimAtPath(TUBE + "1")).GetSkeletonRel().SetTargets([second.GetPath()])
    stage.Save()
    reduced, notes = simplified(tmp_path, joints=2, reduce_skeleton=True)
    assert joints(reduced)[0] == list(NAMES)
    assert notes == [
        f"{path}: all joints stay, as another skeleton has the same animation" for path in ("/Char/Second", SKELETON)
    ]


@pytest.mark.parametrize("flatten", [False, True])
def test_flat_file_has_the_small_skeleton_too(tmp_path, flatten):
    rig(tmp_path / "in.usda")
    reduced, _ = simplified(tmp_path, joints=3, reduce_skeleton=True, flatten=flatten)
    assert [len(names) for names in joints(reduced)] == [3, 3]


def copied(stage: Usd.Stage, path: str) -> Sdf.Path:
    """A second tube at a path of the root layer."""
    Sdf.CopySpec(stage.GetRootLayer(), TUBE, stage.GetRootLayer(), path)
    return Sdf.Path(path)


def test_joints_that_a_mesh_in_a_variant_that_is_not_selected_uses_stay(tmp_path):
    stage = rig(tmp_path / "in.usda")
    parent = stage.GetPrimAtPath(TUBE).GetParent()
    looks = parent.GetVariantSets().AddVariantSet("look")
    for name in ("plain", "rich"):
        looks.AddVariant(name)
    copied(stage, f"{parent.GetPath()}{{look=rich}}other")
    looks.SetVariantSelection("plain")
    stage.Save()
    reduced, notes = simplified(tmp_path, joints=2, reduce_skeleton=True)
    assert [len(names) for names in joints(reduced)] == [len(NAMES)] * 2
    hidden = f"{parent.GetPath()}{{look=rich}}other"
    assert notes == [f"{SKELETON}: all joints stay, as a variant that is not selected has a skin: {hidden}"]


def test_joints_that_a_mesh_of_an_instance_uses_stay(tmp_path):
    stage = rig(tmp_path / "in.usda")
    stage.CreateClassPrim("/Copies")
    # It has the skeleton of the instance, as a target beyond the reference would not count.
    stage.GetPrimAtPath(copied(stage, "/Copies/other")).RemoveProperty("skel:skeleton")
    instance = stage.DefinePrim(f"{stage.GetPrimAtPath(TUBE).GetParent().GetPath()}/instance", "Xform")
    instance.GetReferences().AddInternalReference("/Copies")
    instance.SetInstanceable(True)
    UsdSkel.BindingAPI.Apply(instance).CreateSkeletonRel().SetTargets([SKELETON])
    stage.Save()
    reduced, notes = simplified(tmp_path, joints=2, reduce_skeleton=True, prims=(TUBE,))
    assert [len(names) for names in joints(reduced)] == [len(NAMES)] * 2
    assert notes == [f"{SKELETON}: all joints stay, as {instance.GetPath()}/other is below an instance"]


def test_joints_of_a_skeleton_without_rest_transforms_go_with_its_animation(tmp_path):
    stage = rig(tmp_path / "in.usda")
    stage.GetPrimAtPath(SKELETON).GetAttribute("restTransforms").Clear()
    stage.Save()
    reduced, _ = simplified(tmp_path, joints=2, reduce_skeleton=True)
    whole, _ = simplified(tmp_path, joints=2)
    assert [len(names) for names in joints(reduced)] == [2, 2]
    np.testing.assert_allclose(baked(reduced)[0], baked(whole)[0], atol=1e-5)


def test_joints_stay_where_one_has_a_scale_of_zero(tmp_path):
    stage = rig(tmp_path / "in.usda")
    scales = stage.GetPrimAtPath(ANIMATION).GetAttribute("scales")
    for time in scales.GetTimeSamples() or [Usd.TimeCode.Default()]:
        values = np.array(scales.Get(time), dtype=np.float16)
        values[-1] = 0.0
        scales.Set(Vt.Vec3hArray.FromNumpy(values), time)
    stage.Save()
    reduced, notes = simplified(tmp_path, joints=2, reduce_skeleton=True)
    assert [len(names) for names in joints(reduced)] == [len(NAMES)] * 2
    assert any("has a scale of zero at some time" in note for note in notes)


def test_joints_that_a_file_of_another_variant_uses_stay(tmp_path):
    stage = rig(tmp_path / "in.usda")
    rig(tmp_path / "other.usda")
    parent = stage.GetPrimAtPath(TUBE).GetParent()
    looks = parent.GetVariantSets().AddVariantSet("look")
    for name in ("plain", "rich"):
        looks.AddVariant(name)
    looks.SetVariantSelection("rich")
    with looks.GetVariantEditContext():
        stage.DefinePrim(f"{parent.GetPath()}/other").GetReferences().AddReference("other.usda", TUBE)
    looks.SetVariantSelection("plain")
    stage.Save()
    reduced, notes = simplified(tmp_path, joints=2, reduce_skeleton=True)
    assert [len(names) for names in joints(reduced)] == [len(NAMES)] * 2
    assert notes == [f"{SKELETON}: all joints stay, as a variant that is not selected has a skin: {TUBE}"]
