"""Describing the meshes of a file."""

from __future__ import annotations

from pxr import Gf, Sdf, UsdGeom

from tests.support.usd_stages import cloth_stage, instanced_stage, skinned_stage
from warpqem.usd import inspect_stage


def test_counts_of_a_point_cache(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    [info] = inspect_stage(tmp_path / "in.usda")
    assert (info.path, info.frames, info.first_time, info.last_time) == ("/Root/Cloth", 3, 1.0, 4.0)
    assert (info.vertices, info.faces, info.triangles) == (81, 64, 128)
    assert (info.border_edges, info.non_manifold_edges) == (32, 0)
    assert info.problems == []


def test_skin_of_a_character(tmp_path):
    skinned_stage(tmp_path / "in.usda")
    [info] = inspect_stage(tmp_path / "in.usda")
    assert (info.joints, info.blend_shapes) == (2, 1)


def test_uv_sets_and_subsets_are_named(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth"))
    for name in ("st", "lightmap"):
        primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(name, Sdf.ValueTypeNames.TexCoord2fArray, "vertex")
        primvar.Set([Gf.Vec2f(0)] * 81)
    UsdGeom.Subset.CreateGeomSubset(mesh, "left", "face", [0])
    stage.Save()
    [info] = inspect_stage(tmp_path / "in.usda")
    assert sorted(info.uv_sets) == ["lightmap", "st"]
    assert info.subsets == ["left"]


def test_primvar_of_the_wrong_length_is_a_problem(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    primvars = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/Root/Cloth"))
    primvars.CreatePrimvar("wet", Sdf.ValueTypeNames.FloatArray, "vertex").Set([1.0] * 80)
    stage.Save()
    [info] = inspect_stage(tmp_path / "in.usda")
    assert info.problems == ["primvars:wet: 80 values, 81 expected (vertex)"]


def test_point_that_no_face_uses_is_a_problem(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda", times=None)
    points = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth")).GetPointsAttr()
    points.Set([*points.Get(), Gf.Vec3f(0)])
    stage.Save()
    [info] = inspect_stage(tmp_path / "in.usda")
    assert info.problems == ["points that no face uses: 1"]


def test_mesh_that_cannot_be_read_is_described_by_its_problem(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth")).GetFaceVertexCountsAttr().Set([4])
    stage.Save()
    [info] = inspect_stage(tmp_path / "in.usda")
    assert "faceVertexCounts" in info.problems[0]


def test_mesh_of_instances_is_listed_once(tmp_path):
    instanced_stage(tmp_path / "in.usda")
    infos = inspect_stage(tmp_path / "in.usda")
    assert [(info.path, info.triangles, info.problems) for info in infos] == [
        ("/Root/Cloth", 128, []), ("/Root/First/Cloth", 128, [])
    ]  # fmt: skip
