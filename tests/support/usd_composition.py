"""Stages with references, payloads, sublayers, variants and value clips."""

from __future__ import annotations

from pathlib import Path

from pxr import Gf, Sdf, Usd, UsdGeom, Vt

from tests.support.usd_stages import cloth_stage, quad_grid, waves
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.write.stage_report import StageReport

CLOTH = "/Root/Cloth"


def convert(source: Path, output: Path, **options: object) -> tuple[Usd.Stage, StageReport]:
    report = simplify_stage(source, output, SimplifyOptions(**{"ratio": 0.4, "device": "cpu", **options}))
    return Usd.Stage.Open(str(output)), report


def clip_stage(folder: Path) -> Path:
    """A cloth whose points, velocities and heat come from two value clips."""
    topology = cloth_stage(folder / "topology.usda", times=None)
    manifest = Sdf.Layer.CreateNew(str(folder / "manifest.usda"))
    points, _, _ = quad_grid(8)
    poses = waves(points, 4)
    for clip in range(2):
        stage = Usd.Stage.CreateNew(str(folder / f"clip{clip}.usda"))
        mesh = UsdGeom.Mesh.Define(stage, CLOTH)
        heat = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("heat", Sdf.ValueTypeNames.FloatArray, "vertex")
        for time in (2 * clip, 2 * clip + 1):
            mesh.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(poses[time]), float(time))
            mesh.CreateVelocitiesAttr().Set([Gf.Vec3f(time)] * 81, float(time))
            heat.GetAttr().Set([float(time)] * 81, float(time))
        stage.Save()
    for name, kind in (("points", "Point3fArray"), ("velocities", "Vector3fArray"), ("primvars:heat", "FloatArray")):
        Sdf.JustCreatePrimAttributeInLayer(manifest, f"{CLOTH}.{name}", getattr(Sdf.ValueTypeNames, kind))
    manifest.Save()
    mesh = UsdGeom.Mesh(topology.GetPrimAtPath(CLOTH))
    UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("heat", Sdf.ValueTypeNames.FloatArray, "vertex")
    topology.Save()
    stage = Usd.Stage.CreateNew(str(folder / "in.usda"))
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(3)
    root = stage.DefinePrim("/Root")
    root.GetReferences().AddReference("./topology.usda")
    stage.SetDefaultPrim(root)
    clips = Usd.ClipsAPI(root)
    clips.SetClipAssetPaths([Sdf.AssetPath(f"./clip{clip}.usda") for clip in range(2)])
    clips.SetClipPrimPath("/Root")
    clips.SetClipManifestAssetPath(Sdf.AssetPath("./manifest.usda"))
    clips.SetClipActive([Gf.Vec2d(0, 0), Gf.Vec2d(2, 1)])
    clips.SetClipTimes([Gf.Vec2d(time, time) for time in range(4)])
    stage.Save()
    return folder / "in.usda"
