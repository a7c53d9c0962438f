"""A skinned body, and how far two files' meshes are apart."""

from __future__ import annotations

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel

from tests.support.usd_stages import FRAMES
from warpqem.measure import compare
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.skeleton_poses import StagePoses

BODY = "/Char/Body"


def poses(stage: Usd.Stage) -> tuple[np.ndarray, np.ndarray]:
    """Points at all frames and triangles, through UsdSkel.BakeSkinning, in world space."""
    baked = Usd.Stage.Open(stage.Flatten())
    UsdSkel.BakeSkinning(baked.Traverse())
    mesh = UsdGeom.Mesh(baked.GetPrimAtPath(BODY))
    frames = []
    for time in FRAMES:
        matrix = np.array(UsdGeom.XformCache(time).GetLocalToWorldTransform(mesh.GetPrim()))
        frames.append(np.array(mesh.GetPointsAttr().Get(time)) @ matrix[:3, :3] + matrix[3, :3])
    return np.stack(frames), MeshSource(mesh.GetPrim(), StagePoses(baked)).topology.triangles


def rms(first: Usd.Stage, second: Usd.Stage) -> float:
    return compare(*poses(first), *poses(second), samples=2000, device="cpu").rms
