"""A tube on a chain of five joints, the last of which never turns, and poses of a file as UsdSkel bakes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from tests.support.skin_fit import FACES, JOINTS, SKIN
from warpqem.measure import compare
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.skeleton_poses import StagePoses

TUBE, SKELETON, ANIMATION = "/Char/Tube", "/Char/Skeleton", "/Char/Animation"
NAMES = ("a", "a/b", "a/b/c", "a/b/c/d", "a/b/c/d/tip")
SHAPES = ("left", "right", "both", "nothing")
FRAMES = tuple(range(1, 13))
PLACES = np.append(JOINTS, 0.95)


def rig(path: Path, meshes: int = 1, animated: bool = True) -> Usd.Stage:
    """Write the tube; with more meshes, copies of it on the same skeleton."""
    stage = Usd.Stage.CreateNew(str(path))
    stage.SetStartTimeCode(FRAMES[0])
    stage.SetEndTimeCode(FRAMES[-1])
    stage.SetDefaultPrim(UsdSkel.Root.Define(stage, "/Char").GetPrim())
    skeleton = UsdSkel.Skeleton.Define(stage, SKELETON)
    skeleton.CreateJointsAttr(NAMES)
    places = [Gf.Vec3d(float(x), 0, 0) for x in PLACES]
    steps = np.diff(PLACES, prepend=0.0)
    skeleton.CreateBindTransformsAttr([Gf.Matrix4d().SetTranslate(place) for place in places])
    skeleton.CreateRestTransformsAttr([Gf.Matrix4d().SetTranslate(Gf.Vec3d(float(x), 0, 0)) for x in steps])
    if animated:
        _animate(stage, skeleton, steps)
    joints, weights = _influences()
    for index in range(meshes):
        mesh = UsdGeom.Mesh.Define(stage, TUBE + str(index) * (index > 0))
        mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(SKIN.rest.astype(np.float32)))
        mesh.CreateFaceVertexCountsAttr([3] * len(FACES))
        mesh.CreateFaceVertexIndicesAttr(FACES.ravel().tolist())
        mesh.CreateSubdivisionSchemeAttr("none")
        binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
        binding.CreateSkeletonRel().SetTargets([SKELETON])
        binding.CreateJointIndicesPrimvar(False, 3).Set(joints.ravel().tolist())
        binding.CreateJointWeightsPrimvar(False, 3).Set(weights.ravel().tolist())
    stage.Save()
    return stage


def shaped_rig(path: Path, tokens: tuple[str, ...] = SHAPES, meshes: int = 1) -> Usd.Stage:
    """The same with blend shapes: two swellings, both at once, and one of nothing; their weights are animated."""
    stage = rig(path, meshes)
    ends = np.exp(-(((SKIN.rest[:, :1] - [0.2, 0.8]) / 0.15) ** 2))
    outward = SKIN.rest * [0.0, 1.0, 1.0]
    left, right = (0.6 * outward * ends[:, k : k + 1] for k in range(2))
    values = dict(zip(SHAPES, (left, right, left + right, 0.0 * left), strict=True))
    for index in range(meshes):
        mesh = stage.GetPrimAtPath(TUBE + str(index) * (index > 0))
        targets = []
        for token, offsets in zip(tokens, values.values(), strict=True):
            shape = UsdSkel.BlendShape.Define(stage, mesh.GetPath().AppendChild(token))
            shape.CreateOffsetsAttr(Vt.Vec3fArray.FromNumpy(offsets.astype(np.float32)))
            targets.append(shape.GetPath())
        binding = UsdSkel.BindingAPI(mesh)
        binding.CreateBlendShapesAttr(tokens)
        binding.CreateBlendShapeTargetsRel().SetTargets(targets)
    animation = UsdSkel.Animation(stage.GetPrimAtPath(ANIMATION))
    animation.CreateBlendShapesAttr(tokens)
    weights = animation.CreateBlendShapeWeightsAttr()
    for frame, row in zip(FRAMES, np.random.default_rng(4).uniform(0, 0.5, (len(FRAMES), len(tokens))), strict=True):
        weights.Set([float(value) for value in row], frame)
    stage.Save()
    return stage


def _animate(stage: Usd.Stage, skeleton: UsdSkel.Skeleton, steps: np.ndarray) -> None:
    animation = UsdSkel.Animation.Define(stage, ANIMATION)
    animation.CreateJointsAttr(NAMES)
    animation.CreateTranslationsAttr([Gf.Vec3f(float(x), 0, 0) for x in steps])
    animation.CreateScalesAttr([Gf.Vec3h(1, 1, 1)] * len(NAMES))
    rotations = animation.CreateRotationsAttr()
    angles = np.random.default_rng(3).uniform(-50, 50, (len(FRAMES), len(NAMES)))
    angles[:, -1] = 0
    for frame, row in zip(FRAMES, angles, strict=True):
        turns = [Gf.Rotation(Gf.Vec3d(0, 1, 0.3), float(angle)).GetQuat() for angle in row]
        rotations.Set([Gf.Quatf(turn) for turn in turns], frame)
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([animation.GetPath()])


def _influences() -> tuple[np.ndarray, np.ndarray]:
    distance = np.abs(SKIN.rest[:, :1] - PLACES)
    joints = np.argsort(distance, axis=1, kind="stable")[:, :3].astype(np.int32)
    weights = np.exp(-((np.take_along_axis(distance, joints, axis=1) / 0.12) ** 2))
    return joints, weights / weights.sum(axis=1, keepdims=True)


def baked(stage: Usd.Stage, mesh: str = TUBE) -> tuple[np.ndarray, np.ndarray]:
    """Points at all frames and triangles, through UsdSkel.BakeSkinning."""
    flat = Usd.Stage.Open(stage.Flatten())
    UsdSkel.BakeSkinning(flat.Traverse())
    points = UsdGeom.Mesh(flat.GetPrimAtPath(Sdf.Path(mesh)))
    poses = np.stack([np.array(points.GetPointsAttr().Get(frame)) for frame in FRAMES])
    return poses, MeshSource(points.GetPrim(), StagePoses(flat)).topology.triangles


def rms(first: Usd.Stage, second: Usd.Stage, mesh: str = TUBE) -> float:
    """RMS distance over all frames, in %."""
    return compare(*baked(first, mesh), *baked(second, mesh), samples=2000, device="cpu").rms
