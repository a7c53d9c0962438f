"""Poses of skinned meshes, against UsdSkel.BakeSkinning."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdSkel

from tests.support.usd_stages import FRAMES, cloth_stage, skinned_stage
from warpqem.errors import StageError
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.skeleton_poses import StagePoses

BODY = "/Char/Body"


def source_of(stage: Usd.Stage) -> MeshSource:
    return MeshSource(stage.GetPrimAtPath(BODY), StagePoses(stage))


def baked_world_points(stage: Usd.Stage, time: float) -> np.ndarray:
    baked = Usd.Stage.Open(stage.Flatten())
    assert UsdSkel.BakeSkinning(baked.Traverse())
    return world_points(baked, np.array(UsdGeom.Mesh(baked.GetPrimAtPath(BODY)).GetPointsAttr().Get(time)), time)


def world_points(stage: Usd.Stage, points: np.ndarray, time: float) -> np.ndarray:
    # A rigid binding is baked into the prim's transform, so poses are compared in world space.
    matrix = np.array(UsdGeom.XformCache(time).GetLocalToWorldTransform(stage.GetPrimAtPath(BODY)))
    return points @ matrix[:3, :3] + matrix[3, :3]


def assert_poses_equal_bake(stage: Usd.Stage) -> None:
    source = source_of(stage)
    for time in source.frame_times():
        ours = world_points(stage, source.points_at(time).astype(np.float64), time)
        np.testing.assert_allclose(ours, baked_world_points(stage, time), atol=1e-4)


def test_skinned_and_blend_shaped_poses_equal_bake_skinning():
    assert_poses_equal_bake(skinned_stage())


def test_rigidly_bound_poses_equal_bake_skinning():
    assert_poses_equal_bake(skinned_stage(rigid=True))


def test_rigid_poses_far_from_the_origin_round_as_bake_skinning_does():
    stage = skinned_stage(rigid=True)
    binding = UsdSkel.BindingAPI(stage.GetPrimAtPath(BODY))
    binding.CreateJointIndicesPrimvar(True, 2).Set([0, 1])
    binding.CreateJointWeightsPrimvar(True, 2).Set([0.3, 0.7])
    points = UsdGeom.Mesh(stage.GetPrimAtPath(BODY)).GetPointsAttr()
    points.Set([p + Gf.Vec3f(300, 200, 100) for p in points.Get()])
    assert_poses_equal_bake(stage)


def test_dual_quaternion_poses_equal_bake_skinning():
    stage = skinned_stage()
    UsdSkel.BindingAPI(stage.GetPrimAtPath(BODY)).CreateSkinningMethodAttr(UsdSkel.Tokens.dualQuaternion)
    assert_poses_equal_bake(stage)


def test_blend_shapes_without_joints_equal_bake_skinning():
    stage = skinned_stage()
    for name in ("jointIndices", "jointWeights"):
        stage.GetPrimAtPath(BODY).RemoveProperty(f"primvars:skel:{name}")
    assert_poses_equal_bake(stage)


def test_frames_are_the_samples_of_the_animation():
    assert source_of(skinned_stage()).frame_times() == FRAMES


def test_transform_samples_between_skeleton_and_mesh_are_frames():
    stage = skinned_stage()
    operation = UsdGeom.Xformable(stage.GetPrimAtPath(BODY)).AddTranslateOp(opSuffix="move")
    operation.Set(Gf.Vec3d(0, 0, 0), 1.0)
    operation.Set(Gf.Vec3d(0, 0, 5), 3.0)
    assert source_of(stage).frame_times() == [1.0, 2.0, 3.0, 4.0]
    assert_poses_equal_bake(stage)


def test_transform_samples_of_a_common_ancestor_are_no_frames():
    stage = skinned_stage()
    operation = UsdGeom.Xformable(stage.GetPrimAtPath("/Char")).AddTranslateOp()
    operation.Set(Gf.Vec3d(0, 0, 0), 1.0)
    operation.Set(Gf.Vec3d(0, 0, 5), 3.0)
    assert source_of(stage).frame_times() == FRAMES


def test_skinned_mesh_without_an_animation_is_one_rest_pose():
    stage = skinned_stage()
    stage.RemovePrim("/Char/Rig/Anim")
    source = source_of(stage)
    assert source.frame_times() is None
    np.testing.assert_allclose(
        world_points(stage, source.points_at(None), 0.0), baked_world_points(stage, Usd.TimeCode.Default()), atol=1e-4
    )


def test_mesh_without_a_binding_has_no_poser():
    stage = cloth_stage()
    assert StagePoses(stage).poser(stage.GetPrimAtPath("/Root/Cloth")) is None


def test_joints_and_blend_shapes_are_counted():
    poser = source_of(skinned_stage()).poser
    assert (poser.joint_count, poser.blend_shape_count) == (2, 1)


def test_influence_on_a_joint_that_does_not_exist_is_refused():
    stage = skinned_stage()
    indices = UsdSkel.BindingAPI(stage.GetPrimAtPath(BODY)).GetJointIndicesPrimvar()
    values = list(indices.Get())
    values[1] = 99
    indices.Set(values)
    with pytest.raises(StageError, match="/Char/Body: UsdSkel cannot skin"):
        source_of(stage).read([1.0])
