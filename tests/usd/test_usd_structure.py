"""Stages as they are in the wild: meshes without geometry, below classes, of other types; files of unknown formats."""

from __future__ import annotations

import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel
from typer.testing import CliRunner

from tests.support.usd_checks import check_stage
from tests.support.usd_composition import convert
from tests.support.usd_stages import cloth_stage, define_cloth, define_skinned
from warpqem.cli.main import app
from warpqem.usd import SimplifyOptions, inspect_stage, simplify_stage

WRONG = {
    "int": 7,
    "string": "points",
    "float[]": [1.0] * 81,
    "float2[]": [Gf.Vec2f(1)] * 81,
    "quatf[]": [Gf.Quatf(1)] * 81,
    "token[]": ["a"] * 81,
}


@pytest.mark.parametrize("kind", WRONG)
@pytest.mark.parametrize("name", ["points", "faceVertexCounts", "creaseIndices", "normals", "velocities", "extent"])
def test_attribute_of_another_type_is_named_with_its_type(name, kind, tmp_path):
    stage = cloth_stage(tmp_path / "in.usda", times=None)
    define_cloth(stage, "/Root/Good")
    spec = stage.GetRootLayer().GetPrimAtPath("/Root/Cloth")
    if name in spec.attributes:
        spec.RemoveProperty(spec.attributes[name])
    Sdf.AttributeSpec(spec, name, Sdf.ValueTypeNames.Find(kind)).default = WRONG[kind]
    stage.Save()
    _result, report = convert(tmp_path / "in.usda", tmp_path / "out.usda")
    cloth, good = report.prims
    assert good.status == "simplified"
    if name in ("normals", "velocities", "extent"):
        # A mesh does without them.
        assert cloth.status == "simplified"
        assert any(name in line for line in [*cloth.problems, *cloth.dropped])
    else:
        assert cloth.status == "failed"
        assert f"/Root/Cloth.{name}: declared as {kind} in " in cloth.message


def test_indices_of_a_subset_of_another_type_are_named(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    subset = UsdGeom.Subset.Define(stage, "/Root/Cloth/part").GetPrim()
    stage.Save()
    Sdf.AttributeSpec(
        stage.GetRootLayer().GetPrimAtPath(subset.GetPath()), "indices", Sdf.ValueTypeNames.FloatArray
    ).default = [1.0]
    stage.Save()
    options = SimplifyOptions(ratio=0.4, device="cpu")
    [prim] = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options).prims
    assert "/Root/Cloth/part.indices: declared as float[]" in prim.message


def test_points_of_double_precision_fit(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda", times=None)
    values = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth")).GetPointsAttr().Get()
    spec = stage.GetRootLayer().GetPrimAtPath("/Root/Cloth")
    spec.RemoveProperty(spec.attributes["points"])
    Sdf.AttributeSpec(spec, "points", Sdf.ValueTypeNames.Double3Array).default = [Gf.Vec3d(value) for value in values]
    stage.Save()
    [prim] = convert(tmp_path / "in.usda", tmp_path / "out.usda")[1].prims
    assert (prim.status, prim.faces_before) == ("simplified", 128)


@pytest.mark.parametrize("given", [(), ("points",), ("extent",), ("faceVertexIndices",)])
def test_mesh_without_geometry_is_kept(given, tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    empty = UsdGeom.Mesh.Define(stage, "/Root/Empty")
    values = {"points": [Gf.Vec3f(0)], "extent": [Gf.Vec3f(0)] * 2, "faceVertexIndices": [0, 0, 0]}
    for name in given:
        empty.GetPrim().GetAttribute(name).Set(values[name])
    stage.Save()
    source = str(tmp_path / "in.usda")
    options = ["-o", str(tmp_path / "out.usda"), "--ratio", "0.4", "--device", "cpu"]
    result = CliRunner().invoke(app, ["simplify", source, *options])
    assert result.exit_code == 0, result.output
    assert "/Root/Empty: kept: no geometry: no value of " in result.output
    [_cloth, info] = inspect_stage(tmp_path / "in.usda")
    assert (info.path, info.faces) == ("/Root/Empty", 0)
    assert info.problems[0].startswith("no geometry")


def test_blocked_faces_are_an_error(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth")).GetFaceVertexCountsAttr().Block()
    stage.Save()
    options = SimplifyOptions(ratio=0.4, device="cpu")
    [prim] = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options).prims
    assert "/Root/Cloth.faceVertexCounts: no value at time default (missing or blocked)" in prim.message


def test_file_with_nothing_but_empty_meshes_is_written(tmp_path):
    stage = Usd.Stage.CreateNew(str(tmp_path / "in.usda"))
    UsdGeom.Mesh.Define(stage, "/Empty")
    stage.Save()
    for options in ({}, {"ratio": None, "faces": 10}, {"ratio": None, "lods": (0.5,)}, {"flatten": True}):
        _result, report = convert(tmp_path / "in.usda", tmp_path / "out.usda", **options)
        assert [prim.status for prim in report.prims] == ["kept"]


@pytest.mark.parametrize("arc", ["reference", "payload", "sublayer"])
@pytest.mark.parametrize("name", ["other.abc", "other.xyz", "other"])
def test_file_of_an_unknown_format_is_left_out_with_a_note(arc, name, tmp_path, flatten):
    (tmp_path / name).write_bytes(b"Ogawa\xff")
    stage = cloth_stage(tmp_path / "in.usda")
    prim = stage.DefinePrim("/Root/Cache", "Xform")
    if arc == "sublayer":
        stage.GetRootLayer().subLayerPaths.append(f"./{name}")
    else:
        (prim.GetReferences().AddReference if arc == "reference" else prim.GetPayloads().AddPayload)(f"./{name}")
    stage.GetRootLayer().Save()
    result, report = convert(tmp_path / "in.usda", tmp_path / "out.usda", flatten=flatten)
    assert [prim.status for prim in report.prims] == ["simplified"]
    assert any(name in problem for problem in report.problems), report.problems
    assert len(UsdGeom.Mesh(result.GetPrimAtPath("/Root/Cloth")).GetFaceVertexCountsAttr().Get()) == 51


def test_input_of_an_unknown_format_is_an_error(tmp_path):
    (tmp_path / "in.abc").write_bytes(b"Ogawa\xff")
    result = CliRunner().invoke(app, ["info", str(tmp_path / "in.abc")])
    assert result.exit_code == 1
    assert "convert it to USD" in result.output


@pytest.mark.parametrize("specifier", [Sdf.SpecifierDef, Sdf.SpecifierClass, Sdf.SpecifierOver])
def test_subsets_of_a_mesh_below_a_class_follow(specifier, tmp_path, flatten):
    stage = cloth_stage(tmp_path / "in.usda")
    mesh = define_cloth(stage, "/Root/prototypes/P/Mesh")
    for part, first in (("low", 0), ("high", 32)):
        UsdGeom.Subset.CreateGeomSubset(mesh, part, "face", list(range(first, first + 32)), "materialBind")
    stage.GetPrimAtPath("/Root/prototypes").SetSpecifier(specifier)
    prim = stage.DefinePrim("/Root/I1", "Xform")
    prim.GetReferences().AddInternalReference("/Root/prototypes/P")
    prim.SetInstanceable(True)
    stage.Save()
    assert [info.subsets for info in inspect_stage(tmp_path / "in.usda")][1] == ["low", "high"]
    result, report = convert(tmp_path / "in.usda", tmp_path / "out.usda", flatten=flatten)
    assert [prim.status for prim in report.prims] == ["simplified", "simplified"]
    check_stage(result)
    instanced = UsdGeom.Mesh(result.GetPrimAtPath("/Root/I1/Mesh"))
    counts = [len(instanced.GetPrim().GetChild(part).GetAttribute("indices").Get()) for part in ("low", "high")]
    assert sum(counts) == len(instanced.GetFaceVertexCountsAttr().Get())
    assert min(counts) > 0


@pytest.mark.parametrize("bake", [False, True])
def test_skin_of_a_mesh_below_a_class_follows(bake, tmp_path):
    stage = Usd.Stage.CreateNew(str(tmp_path / "in.usda"))
    define_skinned(stage, "/proto/Char")
    stage.GetPrimAtPath("/proto").SetSpecifier(Sdf.SpecifierClass)
    prim = stage.DefinePrim("/I1")
    prim.GetReferences().AddInternalReference("/proto/Char")
    prim.SetInstanceable(True)
    stage.Save()
    result, report = convert(tmp_path / "in.usda", tmp_path / "out.usda", bake=bake)
    assert [(prim.path, prim.status, prim.frames) for prim in report.prims] == [("/proto/Char/Body", "simplified", 3)]
    mesh = result.GetPrimAtPath("/I1/Body")
    cache = UsdSkel.Cache()
    cache.Populate(UsdSkel.Root(result.GetPrimAtPath("/I1")), Usd.TraverseInstanceProxies())
    query = cache.GetSkinningQuery(mesh)
    if bake:
        assert not (query and query.HasJointInfluences())
        return
    count = len(UsdGeom.Mesh(mesh).GetPointsAttr().Get())
    assert len(query.ComputeJointInfluences()[0]) == 2 * count
    offsets = UsdSkel.BlendShape(result.GetPrimAtPath("/I1/Body/bulge"))
    assert max(offsets.GetPointIndicesAttr().Get(), default=-1) < count
