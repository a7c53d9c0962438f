"""Write a scene as a USD stage."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from scenes.scene import BlendAnimation, Scene
from scenes.skinning import JointPoses, Skeleton

FIRST_TIME_CODE = 1


def write(scene: Scene, path: str | Path) -> None:
    """Write the scene to `path`, whose suffix chooses the format; an existing file is replaced.

    Frame f of the scene is at the time code ``FIRST_TIME_CODE + f``.
    """
    stage = Usd.Stage.CreateInMemory()
    stage.SetStartTimeCode(FIRST_TIME_CODE)
    stage.SetEndTimeCode(FIRST_TIME_CODE + scene.frame_count - 1)
    stage.SetTimeCodesPerSecond(scene.frames_per_second)
    stage.SetFramesPerSecond(scene.frames_per_second)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, scene.meters_per_unit)
    root_path = Sdf.Path(f"/{scene.name}")
    skinned = scene.binding is not None
    root = UsdSkel.Root.Define(stage, root_path) if skinned else UsdGeom.Xform.Define(stage, root_path)
    stage.SetDefaultPrim(root.GetPrim())
    mesh = _write_mesh(stage, root_path.AppendChild("Mesh"), scene)
    if skinned:
        _write_binding(stage, root_path, mesh, scene)
        extents = np.stack([scene.baked().min(axis=1), scene.baked().max(axis=1)], axis=1)
        # The mesh's extent is that of its rest points; what the skeleton makes of it belongs on the root.
        extent = UsdGeom.Boundable(root).CreateExtentAttr(_vectors(extents[0]))
        for frame, box in enumerate(extents):
            extent.Set(_vectors(box), FIRST_TIME_CODE + frame)
    stage.GetRootLayer().Export(str(path))


def _vectors(values: NDArray) -> Vt.Vec3fArray:
    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values, dtype=np.float32))


def _box(points: NDArray) -> Vt.Vec3fArray:
    return _vectors(np.stack([points.min(axis=0), points.max(axis=0)]))


def _write_mesh(stage: Usd.Stage, path: Sdf.Path, scene: Scene) -> UsdGeom.Mesh:
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray([3] * len(scene.faces)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(scene.faces.ravel())))
    points, extent = mesh.CreatePointsAttr(_vectors(scene.points)), mesh.CreateExtentAttr(_box(scene.points))
    if scene.point_samples is not None:
        mesh.CreateDoubleSidedAttr(True)
        for frame, sample in enumerate(scene.point_samples):
            points.Set(_vectors(sample), FIRST_TIME_CODE + frame)
            extent.Set(_box(sample), FIRST_TIME_CODE + frame)
    mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex).Set(_vectors(scene.colors))
    if scene.texture_coordinates is not None:
        primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
            "st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.faceVarying
        )
        primvar.Set(Vt.Vec2fArray.FromNumpy(scene.texture_coordinates.values))
        primvar.SetIndices(Vt.IntArray.FromNumpy(scene.texture_coordinates.indices.ravel()))
    return mesh


def _write_binding(stage: Usd.Stage, root_path: Sdf.Path, mesh: UsdGeom.Mesh, scene: Scene) -> None:
    binding = scene.binding
    skeleton = _write_skeleton(stage, root_path.AppendChild("Skeleton"), binding.skeleton)
    animation = UsdSkel.Animation.Define(stage, skeleton.GetPath().AppendChild("Animation"))
    _write_poses(animation, binding.skeleton, binding.poses)
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    api = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    api.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    api.CreateGeomBindTransformAttr(Gf.Matrix4d(1.0))
    influences = binding.joint_indices.shape[1]
    api.CreateJointIndicesPrimvar(False, influences).Set(Vt.IntArray.FromNumpy(binding.joint_indices.ravel()))
    api.CreateJointWeightsPrimvar(False, influences).Set(Vt.FloatArray.FromNumpy(binding.joint_weights.ravel()))
    if scene.blend is not None:
        _write_blend_shapes(stage, mesh, api, scene.blend)
        animation.CreateBlendShapesAttr([shape.name for shape in scene.blend.shapes])
        weights = animation.CreateBlendShapeWeightsAttr()
        for frame, values in enumerate(scene.blend.weights):
            weights.Set(Vt.FloatArray.FromNumpy(np.ascontiguousarray(values)), FIRST_TIME_CODE + frame)


def _write_skeleton(stage: Usd.Stage, path: Sdf.Path, bones: Skeleton) -> UsdSkel.Skeleton:
    skeleton = UsdSkel.Skeleton.Define(stage, path)
    skeleton.CreateJointsAttr(bones.paths())
    skeleton.CreateJointNamesAttr(list(bones.names))
    local = bones.rest_matrices()
    # USD's matrices act on row vectors.
    skeleton.CreateRestTransformsAttr(Vt.Matrix4dArray([Gf.Matrix4d(m.T.tolist()) for m in local]))
    skeleton.CreateBindTransformsAttr(Vt.Matrix4dArray([Gf.Matrix4d(m.T.tolist()) for m in bones.bind()]))
    return skeleton


def _write_poses(animation: UsdSkel.Animation, bones: Skeleton, poses: JointPoses) -> None:
    animation.CreateJointsAttr(bones.paths())
    translations, rotations = animation.CreateTranslationsAttr(), animation.CreateRotationsAttr()
    animation.CreateScalesAttr(Vt.Vec3hArray([Gf.Vec3h(1.0, 1.0, 1.0)] * len(bones.names)))
    for frame in range(len(poses.rotations)):
        time = FIRST_TIME_CODE + frame
        translations.Set(_vectors(poses.translations[frame]), time)
        turns = [Gf.Quatf(q[0], Gf.Vec3f(*q[1:])) for q in poses.rotations[frame].tolist()]
        rotations.Set(Vt.QuatfArray(turns), time)


def _write_blend_shapes(stage: Usd.Stage, mesh: UsdGeom.Mesh, api: UsdSkel.BindingAPI, blend: BlendAnimation) -> None:
    targets = []
    for shape in blend.shapes:
        prim = UsdSkel.BlendShape.Define(stage, mesh.GetPath().AppendChild(shape.name))
        prim.CreateOffsetsAttr(_vectors(shape.offsets))
        prim.CreatePointIndicesAttr(Vt.IntArray.FromNumpy(shape.vertices))
        targets.append(prim.GetPath())
    api.CreateBlendShapesAttr([shape.name for shape in blend.shapes])
    api.CreateBlendShapeTargetsRel().SetTargets(targets)
