"""Joints of one name, and joints of a mesh that its skeleton lacks: poses and reduced skins are those of UsdSkel."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdSkel, Vt

from tests.support.usd_rig import ANIMATION, FRAMES, NAMES, SKELETON, TUBE, baked, rig, rms
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.skeleton_poses import StagePoses

TWICE = ("a", "a/b", "a/b/c", "a/b/c", "a/b/c/d")
# Joints of the skeleton, and of the mesh where it has an order of its own.
ORDERS = {
    "skeleton": (TWICE, None),
    "mesh": (NAMES, ("a", "a/b", "a/b", "a/b/c/d", "a/b/c/d/tip")),
    "mesh in another order": (NAMES, ("a/b", "a", "a/b", "a/b/c/d", "a/b/c/d/tip")),
    "both": (TWICE, TWICE),
    "both in other orders": (TWICE, ("a/b", "a", "a/b/c", "a/b/c/d", "a/b/c")),
}
LACKING = ("a/b", "a", "q", "a/b/c/d", "a/b/c/d/tip")


def named_rig(path: Path, skeleton: tuple[str, ...], mesh: tuple[str, ...] | None) -> Usd.Stage:
    stage = rig(path)
    for prim in (SKELETON, ANIMATION):
        stage.GetPrimAtPath(prim).GetAttribute("joints").Set(skeleton)
    if mesh is not None:
        UsdSkel.BindingAPI(stage.GetPrimAtPath(TUBE)).CreateJointsAttr(mesh)
    stage.Save()
    return stage


@pytest.mark.parametrize("which", ORDERS)
@pytest.mark.parametrize("options", [{"joints": 3}, {"joint_error": 0.5}, {"joints": 3, "reduce_skeleton": True}])
def test_fewer_joints_where_names_are_repeated(which, options, tmp_path):
    source = named_rig(tmp_path / "in.usda", *ORDERS[which])
    report = simplify_stage(
        tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(ratio=0.3, device="cpu", **options)
    )
    [prim] = report.prims
    assert prim.skin == "fitted"
    assert prim.joints.after < prim.joints.before
    assert any("two joints have the name a/b" in note for note in prim.notes)
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    # The order stays, as a new one by names would not say which joints are meant.
    assert UsdSkel.BindingAPI(stage.GetPrimAtPath(TUBE)).GetJointsAttr().Get() == (
        None if ORDERS[which][1] is None else Vt.TokenArray(ORDERS[which][1])
    )
    assert len(stage.GetPrimAtPath(SKELETON).GetAttribute("joints").Get()) == len(NAMES)
    assert rms(source, stage) == pytest.approx(prim.measured["rms"], rel=0.1)


@pytest.mark.parametrize("mesh", [LACKING, *[order[1] for order in ORDERS.values() if order[1]]])
@pytest.mark.parametrize("kind", [Sdf.ValueTypeNames.FloatArray, Sdf.ValueTypeNames.DoubleArray])
def test_poses_of_joints_that_nothing_moves_equal_bake_skinning(mesh, kind, tmp_path):
    stage = named_rig(tmp_path / "in.usda", NAMES, mesh)
    want = baked(stage)[0]
    prim = stage.GetPrimAtPath(TUBE)
    weights = UsdSkel.BindingAPI(prim).GetJointWeightsPrimvar()
    values, size = np.array(weights.Get()), weights.GetElementSize()
    prim.RemoveProperty(weights.GetName())
    primvar = UsdGeom.PrimvarsAPI(prim).CreatePrimvar("skel:jointWeights", kind, "vertex", size)
    primvar.Set(values if kind == Sdf.ValueTypeNames.FloatArray else Vt.DoubleArray.FromNumpy(values.astype(float)))
    source = MeshSource(prim, StagePoses(stage))
    got = np.stack([source.points_at(frame) for frame in FRAMES])
    np.testing.assert_allclose(got, want, atol=1e-5)


def test_rigid_mesh_with_a_joint_that_its_skeleton_lacks_is_posed_as_bake_skinning_does(tmp_path):
    stage = named_rig(tmp_path / "in.usda", NAMES, LACKING)
    prim = stage.GetPrimAtPath(TUBE)
    binding = UsdSkel.BindingAPI(prim)
    binding.CreateJointIndicesPrimvar(True, 2).Set([2, 3])
    binding.CreateJointWeightsPrimvar(True, 2).Set([0.5, 0.5])
    source = MeshSource(prim, StagePoses(stage))
    flat = Usd.Stage.Open(stage.Flatten())
    UsdSkel.BakeSkinning(flat.Traverse())
    mesh = UsdGeom.Mesh(flat.GetPrimAtPath(TUBE))
    for frame in FRAMES:
        matrix = np.array(mesh.GetLocalTransformation(frame))
        want = np.array(mesh.GetPointsAttr().Get(frame)) @ matrix[:3, :3] + matrix[3, :3]
        np.testing.assert_allclose(source.points_at(frame), want, atol=1e-5)


def test_skin_with_a_joint_that_its_skeleton_lacks_is_fitted(tmp_path):
    source = named_rig(tmp_path / "in.usda", NAMES, LACKING)
    options = SimplifyOptions(ratio=0.3, joints=3, device="cpu")
    [prim] = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options).prims
    assert (prim.skin, prim.joints.after) == ("fitted", 3)
    assert rms(source, Usd.Stage.Open(str(tmp_path / "out.usda"))) == pytest.approx(prim.measured["rms"], rel=0.1)
