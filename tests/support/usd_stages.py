"""Stages that the tests are made on: a cloth, a skinned tube, instances."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

FRAMES = [1.0, 2.0, 4.0]


def quad_grid(size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (V, 3), faceVertexCounts and faceVertexIndices of a flat grid of size x size quads."""
    x, y = np.meshgrid(np.arange(size + 1), np.arange(size + 1))
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1).astype(np.float32)
    first = (np.arange(size)[:, None] * (size + 1) + np.arange(size)).ravel()
    indices = np.stack([first, first + 1, first + size + 2, first + size + 1], axis=1).ravel()
    return points, np.full(size * size, 4, dtype=np.int32), indices.astype(np.int32)


def waves(points: np.ndarray, frame_count: int) -> np.ndarray:
    """Poses (F, V, 3) of a cloth that waves."""
    poses = np.repeat(points[None], frame_count, axis=0)
    for frame in range(frame_count):
        poses[frame, :, 2] = np.sin(points[:, 0] * 0.7 + frame) + 0.3 * np.cos(points[:, 1] + 2.0 * frame)
    return poses


def define_cloth(
    stage: Usd.Stage, path: str, size: int = 8, times: list[float] | None = None, triangles: bool = False
) -> UsdGeom.Mesh:
    """A waving grid with samples at `times`, or one that stands still at the default time."""
    points, counts, indices = quad_grid(size)
    if triangles:
        quads = indices.reshape(-1, 4)
        indices = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).ravel()
        counts = np.full(len(indices) // 3, 3, dtype=np.int32)
    poses = waves(points, len(times or [0]))
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(counts))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(indices))
    mesh.CreateSubdivisionSchemeAttr("none")
    attribute = mesh.CreatePointsAttr()
    for pose, time in zip(poses, times or [Usd.TimeCode.Default()], strict=True):
        attribute.Set(Vt.Vec3fArray.FromNumpy(pose), time)
    return mesh


def cloth_stage(path: Path | None = None, **options: object) -> Usd.Stage:
    """A stage with one waving cloth at /Root/Cloth, saved if it has a path."""
    stage = Usd.Stage.CreateNew(str(path)) if path else Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    stage.SetTimeCodesPerSecond(30)
    stage.SetStartTimeCode(1)
    stage.SetEndTimeCode(4)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/Root").GetPrim())
    define_cloth(stage, "/Root/Cloth", **{"times": FRAMES, **options})
    if path:
        stage.Save()
    return stage


def define_skinned(stage: Usd.Stage, root: str = "/Char", rigid: bool = False) -> UsdGeom.Mesh:
    """A cloth on two joints with a blend shape and an inbetween, with transforms between skeleton and mesh."""
    UsdSkel.Root.Define(stage, root)
    rig = UsdGeom.Xform.Define(stage, f"{root}/Rig")
    rig.AddTranslateOp().Set(Gf.Vec3d(0.5, -1, 2))
    skeleton = UsdSkel.Skeleton.Define(stage, f"{root}/Rig/Skel")
    skeleton.CreateJointsAttr(["hip", "hip/knee"])
    bind = [Gf.Matrix4d(1), Gf.Matrix4d().SetTranslate(Gf.Vec3d(4, 0, 0))]
    skeleton.CreateBindTransformsAttr(bind)
    skeleton.CreateRestTransformsAttr(bind)
    animation = UsdSkel.Animation.Define(stage, f"{root}/Rig/Anim")
    animation.CreateJointsAttr(["hip", "hip/knee"])
    animation.CreateBlendShapesAttr(["bulge"])
    for index, time in enumerate(FRAMES):
        turn = Gf.Rotation(Gf.Vec3d(0, 1, 0), 25.0 * index).GetQuat()
        animation.CreateTranslationsAttr().Set([Gf.Vec3f(0, 0, index), Gf.Vec3f(4, 0, 0)], time)
        animation.CreateRotationsAttr().Set([Gf.Quatf(1), Gf.Quatf(turn)], time)
        animation.CreateScalesAttr().Set([Gf.Vec3h(1), Gf.Vec3h(1)], time)
        animation.CreateBlendShapeWeightsAttr().Set([0.4 * index], time)

    mesh = define_cloth(stage, f"{root}/Body", size=8)
    mesh.AddRotateZOp().Set(30.0)
    count = len(mesh.GetPointsAttr().Get())
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d().SetTranslate(Gf.Vec3d(0, 1, 0)))
    if rigid:
        binding.CreateJointIndicesPrimvar(True, 1).Set([1])
        binding.CreateJointWeightsPrimvar(True, 1).Set([1.0])
        return mesh
    weights = np.linspace(0, 1, count, dtype=np.float32)
    binding.CreateJointIndicesPrimvar(False, 2).Set(Vt.IntArray([0, 1] * count))
    binding.CreateJointWeightsPrimvar(False, 2).Set(
        Vt.FloatArray.FromNumpy(np.stack([1 - weights, weights], axis=1).ravel())
    )
    shape = UsdSkel.BlendShape.Define(stage, f"{root}/Body/bulge")
    shape.CreateOffsetsAttr([Gf.Vec3f(0, 0, 1), Gf.Vec3f(0, 1, 0)])
    shape.CreatePointIndicesAttr([40, 41])
    shape.CreateInbetween("half").SetOffsets([Gf.Vec3f(1, 0, 0), Gf.Vec3f(0, 0, 0)])
    shape.GetInbetween("half").SetWeight(0.5)
    binding.CreateBlendShapesAttr(["bulge"])
    binding.CreateBlendShapeTargetsRel().SetTargets([shape.GetPath()])
    return mesh


def skinned_stage(path: Path | None = None, **options: bool) -> Usd.Stage:
    """A stage with one skinned mesh at /Char/Body, saved if it has a path."""
    stage = Usd.Stage.CreateNew(str(path)) if path else Usd.Stage.CreateInMemory()
    define_skinned(stage, **options)
    if path:
        stage.Save()
    return stage


def instanced_stage(path: Path, local: bool = False) -> Usd.Stage:
    """Two instances of a cloth, of a class of the same file or of another file, and a cloth that is none."""
    stage = cloth_stage(path)
    if local:
        define_cloth(stage, "/Asset/Cloth")
        stage.GetPrimAtPath("/Asset").SetSpecifier(Sdf.SpecifierClass)
    else:
        asset = Usd.Stage.CreateNew(str(path.with_name("asset.usda")))
        define_cloth(asset, "/Asset/Cloth")
        asset.Save()
    for name in ("First", "Second"):
        prim = UsdGeom.Xform.Define(stage, f"/Root/{name}").GetPrim()
        prim.GetReferences().AddReference("" if local else "./asset.usda", "/Asset")
        prim.SetInstanceable(True)
    stage.GetRootLayer().Save()
    return stage
