"""When a skinned mesh is sampled that is written as points."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pxr import Gf, Usd, UsdGeom, UsdSkel

from warpqem.errors import StageError
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.read.bake_times import bake_times


def bending_stage(keys: list[float], metadata: dict[str, float]) -> Usd.Stage:
    """A strip of quads on two joints, the second of which turns from key to key."""
    stage = Usd.Stage.CreateInMemory()
    for key, value in metadata.items():
        stage.GetRootLayer().pseudoRoot.SetInfo(key, value)
    stage.SetDefaultPrim(UsdSkel.Root.Define(stage, "/A").GetPrim())
    skeleton = UsdSkel.Skeleton.Define(stage, "/A/Rig")
    skeleton.CreateJointsAttr(["a", "a/b"])
    bind = [Gf.Matrix4d(1), Gf.Matrix4d().SetTranslate(Gf.Vec3d(4, 0, 0))]
    skeleton.CreateBindTransformsAttr(bind)
    skeleton.CreateRestTransformsAttr(bind)
    animation = UsdSkel.Animation.Define(stage, "/A/Anim")
    animation.CreateJointsAttr(["a", "a/b"])
    animation.CreateTranslationsAttr([(0, 0, 0), (4, 0, 0)])
    animation.CreateScalesAttr([(1, 1, 1), (1, 1, 1)])
    for index, key in enumerate(keys):
        turned = Gf.Quatf(0.5, 0, 0, 0.866025) if index % 2 else Gf.Quatf(1)
        animation.CreateRotationsAttr().Set([Gf.Quatf(1), turned], key)
    mesh = UsdGeom.Mesh.Define(stage, "/A/Strip")
    mesh.CreatePointsAttr([(x, y, 0) for x in range(9) for y in (0, 1)])
    mesh.CreateFaceVertexCountsAttr([4] * 8)
    mesh.CreateFaceVertexIndicesAttr([p for x in range(8) for p in (2 * x, 2 * x + 2, 2 * x + 3, 2 * x + 1)])
    mesh.CreateSubdivisionSchemeAttr("none")
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateJointIndicesPrimvar(False, 1).Set([int(x > 4) for x in range(9) for _ in (0, 1)])
    binding.CreateJointWeightsPrimvar(False, 1).Set([1.0] * 18)
    binding.CreateSkeletonRel().SetTargets(["/A/Rig"])
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets(["/A/Anim"])
    return stage


def times_of(stage: Usd.Stage, path: str = "/A/Strip") -> list[float]:
    return UsdGeom.Mesh(stage.GetPrimAtPath(path)).GetPointsAttr().GetTimeSamples()


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.integers(-20, 60).map(lambda n: n / 4), min_size=1, max_size=3, unique=True),
    st.fixed_dictionaries(
        {},
        optional={
            "startTimeCode": st.sampled_from([0.0, 1.0, -2.25, 5.0]),
            "endTimeCode": st.sampled_from([0.0, 3.0, 3.3, 7.5, 10.0]),
            "timeCodesPerSecond": st.sampled_from([10.0, 24.0, 30.0]),
            "framesPerSecond": st.sampled_from([24.0, 25.0, 30.0]),
        },
    ),
)
def test_times_are_those_of_usd_skel(keys, metadata):
    stage = bending_stage(sorted(keys), metadata)
    expected = bake_times(stage, sorted(keys))
    UsdSkel.BakeSkinning(UsdSkel.Root(stage.GetPrimAtPath("/A")))
    assert times_of(stage) == expected


def test_baked_mesh_has_a_sample_at_every_frame_between_two_keys(tmp_path):
    metadata = {"startTimeCode": 1.0, "endTimeCode": 11.0}
    # A layer does not keep its stage alive, nor a stage in memory its layer for others.
    stage = bending_stage([1.0, 11.0], metadata)
    stage.GetRootLayer().Export(str(tmp_path / "in.usda"))
    report = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(ratio=0.8, bake=True))
    assert times_of(Usd.Stage.Open(str(tmp_path / "out.usda"))) == [float(time) for time in range(1, 12)]
    assert report.prims[0].dropped == []


def test_skin_that_stays_keeps_its_keys(tmp_path):
    metadata = {"startTimeCode": 1.0, "endTimeCode": 11.0}
    # A layer does not keep its stage alive, nor a stage in memory its layer for others.
    stage = bending_stage([1.0, 11.0], metadata)
    stage.GetRootLayer().Export(str(tmp_path / "in.usda"))
    report = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(ratio=0.8))
    assert report.prims[0].frames == 2


def test_frames_without_end_are_refused_by_name():
    stage = Usd.Stage.CreateInMemory("endless.usda")
    stage.GetRootLayer().pseudoRoot.SetInfo("startTimeCode", 0.0)
    stage.GetRootLayer().pseudoRoot.SetInfo("endTimeCode", 1e15)
    with pytest.raises(StageError, match=r"endless\.usda: \d+ frames between the keys at 0 and"):
        bake_times(stage, [0.0, 1e15])
