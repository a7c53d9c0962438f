"""Captures: meshes whose topology varies over time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, Vt

from tests.support.usd_stages import quad_grid
from warpqem.usd import SimplifyOptions, simplify_stage

PATH = "/Root/Capture"


def bumps(size: int, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A sheet of size x size quads over the unit square that moves with time, whatever its topology."""
    points, counts, indices = quad_grid(size)
    points = points / np.float32(size)
    points[:, 2] = 0.2 * np.sin(5 * points[:, 0] + 0.3 * time) * np.cos(4 * points[:, 1])
    return points.astype(np.float32), counts, indices


def define_capture(
    stage: Usd.Stage, sizes: list[int], frames: int, path: str = PATH, every_frame: bool = False
) -> UsdGeom.Mesh:
    """A mesh with a run of so many frames for each size; its topology has a sample at each run, or at each frame."""
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreateSubdivisionSchemeAttr("none")
    api = UsdGeom.PrimvarsAPI(mesh)
    st = api.CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, "faceVarying")
    heat = api.CreatePrimvar("heat", Sdf.ValueTypeNames.FloatArray, "vertex")
    patch = api.CreatePrimvar("patch", Sdf.ValueTypeNames.IntArray, "uniform")
    half = UsdGeom.Subset.Define(stage, f"{path}/half")
    half.CreateElementTypeAttr("face")
    half.CreateFamilyNameAttr("materialBind")
    for run, size in enumerate(sizes):
        for frame in range(frames):
            time = float(run * frames + frame)
            points, counts, indices = bumps(size, time)
            mesh.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(points), time)
            mesh.CreateVelocitiesAttr().Set(Vt.Vec3fArray.FromNumpy(points * np.float32(0.1)), time)
            mesh.CreateExtentAttr().Set(UsdGeom.PointBased.ComputeExtent(points), time)
            heat.Set(Vt.FloatArray.FromNumpy(points[:, 0] + np.float32(time)), time)
            if frame == 0 or every_frame:
                mesh.CreateFaceVertexCountsAttr().Set(Vt.IntArray.FromNumpy(counts), time)
                mesh.CreateFaceVertexIndicesAttr().Set(Vt.IntArray.FromNumpy(indices), time)
            if frame == 0:
                st.Set(Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(points[indices, :2])), time)
                left = points[indices.reshape(-1, 4), 0].mean(axis=1) < 0.5
                patch.Set(Vt.IntArray.FromNumpy(left.astype(np.int32) + 10 * run), time)
                half.CreateIndicesAttr().Set(Vt.IntArray.FromNumpy(np.flatnonzero(left).astype(np.int32)), time)
    return mesh


# A prim does not keep its stage alive.
HELD: list[Usd.Stage] = []


def capture(path: Path, sizes: list[int], frames: int, **options: Any) -> UsdGeom.Mesh:
    """The same as the only mesh of a file."""
    stage = Usd.Stage.CreateNew(str(path))
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/Root").GetPrim())
    define_capture(stage, sizes, frames, **options)
    stage.Save()
    HELD.append(stage)
    return UsdGeom.Mesh(stage.GetPrimAtPath(PATH))


def simplified(folder: Path, **options: Any) -> tuple[Any, UsdGeom.Mesh]:
    """The report on the only mesh of in.usda, and that mesh of the output."""
    report = simplify_stage(folder / "in.usda", folder / "out.usda", SimplifyOptions(device="cpu", **options))
    [prim] = report.prims
    stage = Usd.Stage.Open(str(folder / "out.usda"))
    HELD.append(stage)
    return prim, UsdGeom.Mesh(stage.GetPrimAtPath(PATH))


def check_at(mesh: UsdGeom.Mesh, time: float) -> None:
    """Everything that a renderer reads of a mesh at one time fits together."""
    counts, indices = (
        np.asarray(attribute.Get(time))
        for attribute in (mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr())
    )
    points = np.asarray(mesh.GetPointsAttr().Get(time))
    assert counts.sum() == len(indices)
    assert indices.min() >= 0
    assert indices.max() < len(points)
    sizes = {"vertex": len(points), "uniform": len(counts), "faceVarying": len(indices)}
    for primvar in UsdGeom.PrimvarsAPI(mesh).GetPrimvarsWithAuthoredValues():
        assert len(primvar.ComputeFlattened(time)) == sizes[primvar.GetInterpolation()], primvar.GetAttr().GetPath()
    for subset in UsdGeom.Subset.GetAllGeomSubsets(mesh):
        members = np.asarray(subset.GetIndicesAttr().Get(time))
        assert 0 < len(members) < len(counts)
        assert members.max() < len(counts)
