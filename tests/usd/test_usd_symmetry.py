"""Symmetric meshes on a stage that stay symmetric."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, Vt

from tests.support.symmetry import FACES, POINTS
from tests.support.usd_stages import cloth_stage
from warpqem.errors import OptionError
from warpqem.pipeline.mirror import find_mirror
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.write.stage_report import PrimReport

TUBE = "/Root/Tube"


def tube_stage(folder: Path) -> Usd.Stage:
    """A symmetric tube that bends to one side, with texture coordinates."""
    stage = Usd.Stage.CreateNew(str(folder / "in.usda"))
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/Root").GetPrim())
    mesh = UsdGeom.Mesh.Define(stage, TUBE)
    mesh.CreateFaceVertexCountsAttr([3] * len(FACES))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(FACES.ravel().astype(np.int32)))
    mesh.CreateSubdivisionSchemeAttr("none")
    for time, points in enumerate(POINTS):
        mesh.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(points), time)
    uv = Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(POINTS[0][:, :2]))
    UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, "vertex").Set(uv)
    stage.Save()
    return stage


def simplified(folder: Path, **options: object) -> tuple[Usd.Stage, PrimReport]:
    options = {"ratio": 0.2, "symmetry": "auto", "device": "cpu", **options}
    report = simplify_stage(folder / "in.usda", folder / "out.usda", SimplifyOptions(**options))
    return Usd.Stage.Open(str(folder / "out.usda")), report.prims[0]


def test_symmetric_mesh_stays_symmetric_with_its_primvars(tmp_path):
    tube_stage(tmp_path)
    stage, report = simplified(tmp_path, uv_weight=0.1)
    assert (report.symmetry, report.status) == ("kept", "simplified")
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(TUBE))
    points = np.array(mesh.GetPointsAttr().Get(0))
    faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    assert len(faces) <= round(0.2 * len(FACES))
    assert len(find_mirror(points, faces, "x").half) == len(faces) // 2
    assert len(mesh.GetPointsAttr().GetTimeSamples()) == len(POINTS)
    uv = np.array(UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st").Get())
    np.testing.assert_allclose(uv, points[:, :2], atol=0.05)


def test_every_level_is_symmetric(tmp_path):
    tube_stage(tmp_path)
    stage, _ = simplified(tmp_path, ratio=None, lods=(0.5, 0.2))
    counts = []
    for name in ("LOD1", "LOD2"):
        stage.GetPrimAtPath("/Root").GetVariantSets().SetSelection("LOD", name)
        mesh = UsdGeom.Mesh(stage.GetPrimAtPath(TUBE))
        faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
        counts.append(len(faces))
        find_mirror(np.array(mesh.GetPointsAttr().Get(0)), faces, "x")
    assert len(FACES) > counts[0] > counts[1]


def test_mesh_that_is_not_symmetric_is_simplified_as_usual_and_says_why(tmp_path):
    cloth_stage(tmp_path / "in.usda", times=[1.0, 2.0])
    _, report = simplified(tmp_path, ratio=0.5)
    assert report.status == "simplified"
    assert report.symmetry.startswith("symmetry: the mesh has no mirror plane: across x ")


def test_unknown_axis_is_refused():
    with pytest.raises(OptionError, match="symmetry must be 'x' or 'y' or 'z' or 'auto', got 'w'"):
        SimplifyOptions(ratio=0.5, symmetry="w")
