"""Write a face in motion as a file of its own: points over time, or blend shapes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pxr import Sdf, Usd, UsdGeom, UsdSkel, Vt

from warpqem.face.retarget import RetargetedMotion

__all__ = ["write_blend_shapes", "write_samples"]


def write_samples(
    stage: Usd.Stage, path: str, faces: npt.NDArray[np.int32], moved: RetargetedMotion, times: list[float]
) -> None:
    """Define the mesh with its points at each time."""
    mesh = _define(stage, path, faces)
    for time, pose in zip(times, moved.points, strict=True):
        mesh.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(pose)), time)
        mesh.CreateExtentAttr().Set(_extent(pose), time)


def write_blend_shapes(
    stage: Usd.Stage, path: str, faces: npt.NDArray[np.int32], moved: RetargetedMotion, times: list[float]
) -> None:
    """Define the mesh at rest with a blend shape for each frame, fully on at its time.

    Blend shapes need a skeleton root; the mesh moves below one, `/Face`.
    """
    UsdSkel.Root.Define(stage, "/Face")
    mesh = _define(stage, f"/Face/{Sdf.Path(path).name}", faces)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(moved.neutral)))
    mesh.CreateExtentAttr(_extent(moved.neutral))
    skeleton = UsdSkel.Skeleton.Define(stage, "/Face/Skeleton")
    animation = UsdSkel.Animation.Define(stage, "/Face/Skeleton/Animation")
    names = [f"frame_{index:04d}" for index in range(len(times))]
    for name, (vertices, offsets) in zip(names, moved.blend_shapes(), strict=True):
        shape = UsdSkel.BlendShape.Define(stage, mesh.GetPath().AppendChild(name))
        shape.CreateOffsetsAttr(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(offsets)))
        shape.CreatePointIndicesAttr(Vt.IntArray.FromNumpy(vertices))
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    binding.CreateBlendShapesAttr(names)
    binding.CreateBlendShapeTargetsRel().SetTargets([mesh.GetPath().AppendChild(name) for name in names])
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    animation.CreateBlendShapesAttr(names)
    weights = animation.CreateBlendShapeWeightsAttr()
    for time, row in zip(times, np.eye(len(times), dtype=np.float32), strict=True):
        weights.Set(Vt.FloatArray.FromNumpy(row), time)


def _define(stage: Usd.Stage, path: str, faces: npt.NDArray[np.int32]) -> UsdGeom.Mesh:
    mesh = UsdGeom.Mesh.Define(stage, path)
    stage.SetDefaultPrim(stage.GetPrimAtPath(mesh.GetPath().GetPrefixes()[0]))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, dtype=np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(faces.ravel())))
    return mesh


def _extent(points: npt.NDArray[np.float32]) -> Vt.Vec3fArray:
    return Vt.Vec3fArray.FromNumpy(np.stack([points.min(axis=0), points.max(axis=0)]))
