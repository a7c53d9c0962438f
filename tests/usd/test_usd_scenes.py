"""The project's scenes, simplified end to end."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdSkel

from warpqem.usd import FrameRange, SimplifyOptions, simplify_stage
from warpqem.usd.read.open_stage import find_meshes, open_stage
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.skeleton_poses import StagePoses

SCENES = sorted((Path(__file__).parents[2] / "scenes").glob("*.usd*"))
# Further USD files to read poses from, where a folder is named.
EXTRA = (
    sorted(Path(os.environ.get("WARPQEM_TEST_DATA", "")).glob("**/*.usd*")) if "WARPQEM_TEST_DATA" in os.environ else []
)


@pytest.mark.parametrize("scene", SCENES, ids=lambda path: path.stem)
def test_scene_keeps_every_array_in_step_with_its_faces(scene, tmp_path):
    stage = open_stage(scene)
    start = stage.GetStartTimeCode()
    options = SimplifyOptions(ratio=0.2, key_frames=2, frames=FrameRange(start, start + 1), device="cpu")
    report = simplify_stage(scene, tmp_path / "out.usdc", options)
    assert [prim.status for prim in report.prims] == ["simplified"] * len(report.prims)
    result = Usd.Stage.Open(str(tmp_path / "out.usdc"))
    for prim in find_meshes(result).prims:
        mesh = UsdGeom.Mesh(prim)
        indices = np.array(mesh.GetFaceVertexIndicesAttr().Get())
        times = mesh.GetPointsAttr().GetTimeSamples() or [Usd.TimeCode.Default()]
        lengths = {len(mesh.GetPointsAttr().Get(time)) for time in times}
        assert lengths == {indices.max() + 1}
        expected = {"vertex": indices.max() + 1, "faceVarying": len(indices), "uniform": len(indices) // 3}
        for primvar in UsdGeom.PrimvarsAPI(prim).GetPrimvarsWithAuthoredValues():
            if primvar.GetInterpolation() in expected:
                length = expected[primvar.GetInterpolation()] * primvar.GetElementSize()
                assert len(primvar.ComputeFlattened()) == length


@pytest.mark.parametrize("scene", [*SCENES, *EXTRA], ids=lambda path: path.name)
def test_poses_of_a_scene_equal_bake_skinning(scene):
    stage = open_stage(scene)
    baked = Usd.Stage.Open(stage.Flatten())
    assert UsdSkel.BakeSkinning(baked.Traverse())
    poses = StagePoses(stage)
    prims = [prim for prim in find_meshes(stage).prims if poses.poser(prim)]
    if not prims:
        pytest.skip("no skinned mesh")
    for prim in prims:
        source = MeshSource(prim, poses)
        times = source.frame_times() or [None]
        for time in (times[0], times[len(times) // 2]):
            expected = UsdGeom.Mesh(baked.GetPrimAtPath(prim.GetPath()))
            code = Usd.TimeCode.Default() if time is None else Usd.TimeCode(time)
            points = np.array(expected.GetPointsAttr().Get(code))
            theirs = in_world(expected.GetPrim(), points, code)
            ours = in_world(prim, source.points_at(time), code)
            np.testing.assert_allclose(ours, theirs, atol=1e-4 * np.ptp(theirs, axis=0).max())


def in_world(prim: Usd.Prim, points: np.ndarray, code: Usd.TimeCode) -> np.ndarray:
    """Rigid bindings are baked into the transform, so poses are compared in world space."""
    matrix = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(prim))
    return points @ matrix[:3, :3] + matrix[3, :3]
