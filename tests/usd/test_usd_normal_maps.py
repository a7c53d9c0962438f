"""Normal maps baked for meshes of a stage: what is written, how it is wired, and where there can be none."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pxr import Ar, Sdf, Usd, UsdGeom, UsdShade, Vt
from typer.testing import CliRunner

from tests.support.usd_findings import nvidia_findings, usd_findings
from tests.support.usd_stages import skinned_stage
from tests.support.usd_textured import (
    SIDE,
    add_map,
    bind,
    bumpy_points,
    define_material,
    define_sheet,
    map_file,
    map_vectors,
    normal_texture,
    sheet_stage,
    wave_normals,
    write_tilted_map,
)
from tests.support.usd_topology_runs import capture
from tests.support.usd_validators import new_findings
from warpqem.batching.manifest import read_manifest
from warpqem.cli.main import app
from warpqem.errors import OptionError
from warpqem.normal_maps.tangents import corner_tangents
from warpqem.picture import View, render
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.commands.simplify_meshes import simplify_mesh_files
from warpqem.usd.read.materials import Materials
from warpqem.usd.read.normal_textures import NormalTextures
from warpqem.usd.read.world import WorldMeshes

SIZE = 32


def bake(source: Path, output: Path, **options: object):
    given = {"ratio": 0.2, "bake_normals": SIZE, "device": "cpu", **options}
    return simplify_stage(source, output, SimplifyOptions(**given))


def baked(source: Path, output: Path, **options: object) -> Usd.Stage:
    report = bake(source, output, **options)
    assert not [line for prim in report.prims for line in prim.problems], report
    return Usd.Stage.Open(str(output))


def angles(stage: Usd.Stage, path: str, file: str) -> np.ndarray:
    """Degrees between the wave's normals and those that the map and the mesh give, at the middles of its texels."""
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(path))
    code = Usd.TimeCode.EarliestTime()
    faces = np.array(mesh.GetFaceVertexIndicesAttr().Get(code)).reshape(-1, 3)
    corners = np.array(mesh.GetPointsAttr().Get(code))[faces]
    normals = np.array(mesh.GetNormalsAttr().Get(code))
    normals = normals[faces] if mesh.GetNormalsInterpolation() == "vertex" else normals.reshape(-1, 3, 3)
    primvar = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st")
    uvs = np.array(primvar.ComputeFlattened(code))
    uvs = uvs[faces] if primvar.GetInterpolation() == "vertex" else uvs.reshape(-1, 3, 2)
    if mesh.GetOrientationAttr().Get() == "leftHanded":
        corners, normals, uvs = corners[:, ::-1], normals[:, ::-1], uvs[:, ::-1]
    tangents = corner_tangents(corners, normals, uvs)
    weight = np.random.default_rng(1).dirichlet([1, 1, 1], len(faces))
    tangent, normal, uv, point = (
        np.einsum("nk,nkc->nc", weight, given) for given in (tangents[..., :3], normals, uvs, corners)
    )
    bitangent = tangents[:, 0, 3:] * np.cross(normal, tangent)
    vectors = map_vectors(file)
    place = np.clip((uv * SIZE).astype(int), 0, SIZE - 1)
    vector = vectors[SIZE - 1 - place[:, 1], place[:, 0]]
    found = vector[:, :1] * tangent + vector[:, 1:2] * bitangent + vector[:, 2:] * normal
    found /= np.linalg.norm(found, axis=1, keepdims=True)
    return np.degrees(np.arccos(np.clip((found * wave_normals(point)).sum(axis=1), -1, 1)))


def test_map_is_wired_as_renderers_read_it(tmp_path):
    sheet_stage(tmp_path / "in.usda")
    stage = baked(tmp_path / "in.usda", tmp_path / "out.usda")
    texture = normal_texture(stage, "/Root/Sheet")
    values = {port.GetBaseName(): port.Get() for port in texture.GetInputs()}
    assert texture.GetIdAttr().Get() == "UsdUVTexture"
    assert (values["scale"], values["bias"]) == ((2, 2, 2, 1), (-1, -1, -1, 0))
    assert values["sourceColorSpace"] == "raw"
    reader = UsdShade.Shader(texture.GetInput("st").GetConnectedSources()[0][0].source.GetPrim())
    assert reader.GetIdAttr().Get() == "UsdPrimvarReader_float2"
    assert reader.GetInput("varname").Get() == "st"
    file = map_file(stage, "/Root/Sheet")
    assert file == str(tmp_path / "out_textures" / "Sheet_normal.png")
    assert Image.open(file).size == (SIZE, SIZE)
    assert Image.open(file).mode == "RGB"


def test_map_restores_the_normals_of_the_input(tmp_path):
    sheet_stage(tmp_path / "in.usda")
    stage = baked(tmp_path / "in.usda", tmp_path / "out.usda", ratio=0.05)
    assert angles(stage, "/Root/Sheet", map_file(stage, "/Root/Sheet")).mean() < 1.5


def test_mirrored_coordinates_restore_them_as_well(tmp_path):
    sheet_stage(tmp_path / "in.usda", uvs=bumpy_points()[:, :2] * [-1, 1] + [1, 0])
    stage = baked(tmp_path / "in.usda", tmp_path / "out.usda", ratio=0.05)
    assert angles(stage, "/Root/Sheet", map_file(stage, "/Root/Sheet")).mean() < 1.5


def test_left_handed_mesh_restores_them_as_well(tmp_path):
    stage = sheet_stage(tmp_path / "in.usda")
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Sheet"))
    turned = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 4)[:, ::-1].ravel()
    mesh.GetFaceVertexIndicesAttr().Set(Vt.IntArray.FromNumpy(np.ascontiguousarray(turned)))
    mesh.CreateOrientationAttr("leftHanded")
    stage.Save()
    out = baked(tmp_path / "in.usda", tmp_path / "out.usda", ratio=0.05)
    assert angles(out, "/Root/Sheet", map_file(out, "/Root/Sheet")).mean() < 1.5


def test_bound_material_keeps_all_else(tmp_path):
    Image.new("RGB", (4, 4), (10, 20, 30)).save(tmp_path / "color.png")
    stage = sheet_stage(tmp_path / "in.usda")
    bind(stage.GetPrimAtPath("/Root/Sheet"), define_material(stage, "/Root/Looks/paint", "./color.png"))
    stage.Save()
    out = baked(tmp_path / "in.usda", tmp_path / "out.usda")
    material = UsdShade.MaterialBindingAPI(out.GetPrimAtPath("/Root/Sheet")).ComputeBoundMaterial()[0]
    surface = material.ComputeSurfaceSource()[0]
    assert surface.GetInput("roughness").Get() == 0.25
    color = UsdShade.Shader(surface.GetInput("diffuseColor").GetConnectedSources()[0][0].source.GetPrim())
    assert color.GetInput("file").Get().resolvedPath == str(tmp_path / "color.png")
    # That of the input is as it was.
    original = UsdShade.Material.Get(out, "/Root/Looks/paint")
    assert not original.ComputeSurfaceSource()[0].GetInput("normal")


def test_meshes_of_one_material_have_a_map_each(tmp_path):
    stage = sheet_stage(tmp_path / "in.usda", "One", "Other")
    material = define_material(stage, "/Root/paint")
    for name in ("One", "Other"):
        bind(stage.GetPrimAtPath(f"/Root/{name}"), material)
    stage.Save()
    out = baked(tmp_path / "in.usda", tmp_path / "out.usda")
    files = [Path(map_file(out, f"/Root/{name}")).name for name in ("One", "Other")]
    assert files == ["One_normal.png", "Other_normal.png"]


def test_meshes_of_one_name_have_files_of_their_own(tmp_path):
    stage = sheet_stage(tmp_path / "in.usda", "a/Sheet", "b/Sheet", "c/sheet")
    stage.Save()
    out = baked(tmp_path / "in.usda", tmp_path / "out.usda")
    files = [map_file(out, f"/Root/{name}") for name in ("a/Sheet", "b/Sheet", "c/sheet")]
    assert len({file.casefold() for file in files}) == 3
    assert all(Path(file).is_file() for file in files)


def subset_stage(path: Path, uvs: np.ndarray | None = None) -> Usd.Stage:
    """A sheet whose left half has a material of its own."""
    stage = sheet_stage(path, uvs=uvs)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Sheet"))
    bind(mesh.GetPrim(), define_material(stage, "/Root/paint"))
    left = np.flatnonzero(np.arange(SIDE * SIDE) % SIDE < SIDE // 2).astype(np.int32)
    subset = UsdGeom.Subset.CreateGeomSubset(
        mesh, "left", "face", Vt.IntArray.FromNumpy(left), "materialBind", "nonOverlapping"
    )
    bind(subset.GetPrim(), define_material(stage, "/Root/metal"))
    stage.Save()
    return stage


def test_subsets_that_share_the_square_share_a_map(tmp_path):
    subset_stage(tmp_path / "in.usda")
    out = baked(tmp_path / "in.usda", tmp_path / "out.usda")
    files = {map_file(out, path) for path in ("/Root/Sheet", "/Root/Sheet/left")}
    assert files == {str(tmp_path / "out_textures" / "Sheet_normal.png")}
    names = [
        UsdShade.MaterialBindingAPI(out.GetPrimAtPath(path)).ComputeBoundMaterial()[0].GetPrim().GetName()
        for path in ("/Root/Sheet", "/Root/Sheet/left")
    ]
    assert names == ["paint_baked", "metal_baked"]


def test_subsets_that_lie_on_each_other_have_a_map_each(tmp_path):
    # Both halves take the whole square.
    points = bumpy_points()
    uvs = np.stack([np.abs(2 * points[:, 0] - 1), points[:, 1]], axis=1)
    subset_stage(tmp_path / "in.usda", uvs)
    out = baked(tmp_path / "in.usda", tmp_path / "out.usda")
    files = [Path(map_file(out, path)).name for path in ("/Root/Sheet", "/Root/Sheet/left")]
    assert files == ["Sheet_normal.png", "Sheet_left_normal.png"]


@pytest.mark.parametrize(
    ("uvs", "text"),
    [
        (bumpy_points()[:, :2] * 2, r"primvars:st is not within 0 and 1, but from \(0, 0\) to \(2, 2\)"),
        (np.abs(bumpy_points()[:, :2] * [2, 1] - [1, 0]), r"primvars:st overlaps on 9\d(\.\d)? % of its texels"),
        (bumpy_points()[:, :2] * [1, 0], r"primvars:st gives no face an area"),
    ],
    ids=["outside", "folded", "flat"],
)
def test_coordinates_that_hold_no_map_leave_the_material_alone(uvs, text, tmp_path):
    stage = sheet_stage(tmp_path / "in.usda", uvs=uvs)
    bind(stage.GetPrimAtPath("/Root/Sheet"), define_material(stage, "/Root/paint"))
    stage.Save()
    report = bake(tmp_path / "in.usda", tmp_path / "out.usda")
    (line,) = report.prims[0].problems
    assert line.startswith("/Root/Sheet: no normal map: ")
    assert re.search(text, line), line
    assert report.prims[0].status == "simplified"
    out = Usd.Stage.Open(str(tmp_path / "out.usda"))
    material = UsdShade.MaterialBindingAPI(out.GetPrimAtPath("/Root/Sheet")).ComputeBoundMaterial()[0]
    assert material.GetPath() == "/Root/paint"
    assert not (tmp_path / "out_textures").exists()


def test_mesh_without_coordinates_says_so(tmp_path):
    stage = sheet_stage(tmp_path / "in.usda")
    stage.GetPrimAtPath("/Root/Sheet").RemoveProperty("primvars:st")
    stage.Save()
    report = bake(tmp_path / "in.usda", tmp_path / "out.usda")
    assert report.prims[0].problems == ["/Root/Sheet: no normal map: it has no texture coordinates"]


def test_empty_material_gets_a_surface(tmp_path):
    stage = sheet_stage(tmp_path / "in.usda")
    bind(stage.GetPrimAtPath("/Root/Sheet"), UsdShade.Material.Define(stage, "/Root/paint"))
    stage.Save()
    out = baked(tmp_path / "in.usda", tmp_path / "out.usda")
    material = UsdShade.MaterialBindingAPI(out.GetPrimAtPath("/Root/Sheet")).ComputeBoundMaterial()[0]
    assert material.GetPrim().GetInherits().GetAllDirectInherits() == ["/Root/paint"]
    assert Path(map_file(out, "/Root/Sheet")).is_file()


def test_material_that_is_no_preview_surface_says_so(tmp_path):
    stage = sheet_stage(tmp_path / "in.usda")
    material = UsdShade.Material.Define(stage, "/Root/paint")
    shader = UsdShade.Shader.Define(stage, "/Root/paint/omni")
    material.CreateSurfaceOutput("mdl").ConnectToSource(shader.ConnectableAPI(), "out")
    bind(stage.GetPrimAtPath("/Root/Sheet"), material)
    stage.Save()
    report = bake(tmp_path / "in.usda", tmp_path / "out.usda")
    assert report.prims[0].problems == ["/Root/Sheet: no normal map: the material /Root/paint has no UsdPreviewSurface"]


def test_binding_that_goes_before_all_others_says_so(tmp_path):
    stage = sheet_stage(tmp_path / "in.usda")
    binding = UsdShade.MaterialBindingAPI.Apply(stage.GetPrimAtPath("/Root"))
    binding.Bind(define_material(stage, "/Root/paint"), UsdShade.Tokens.strongerThanDescendants)
    stage.Save()
    report = bake(tmp_path / "in.usda", tmp_path / "out.usda")
    assert "/Root.material:binding binds a material that no other binding goes before" in report.prims[0].problems[0]


def test_map_of_the_input_is_in_the_baked_one(tmp_path):
    write_tilted_map(tmp_path / "bumps.png", (0.3, -0.2, 1.0))
    stage = sheet_stage(tmp_path / "in.usda")
    material = define_material(stage, "/Root/paint")
    add_map(material, "./bumps.png")
    bind(stage.GetPrimAtPath("/Root/Sheet"), material)
    stage.Save()
    # Hardly simplified, so that the frames of both are nearly the same.
    out = baked(tmp_path / "in.usda", tmp_path / "out.usda", ratio=0.7)
    wanted = np.array([0.3, -0.2, 1.0]) / np.linalg.norm([0.3, -0.2, 1.0])
    vectors = map_vectors(map_file(out, "/Root/Sheet"))
    assert np.abs(vectors.mean(axis=(0, 1)) - wanted).max() < 0.02
    texture = normal_texture(out, "/Root/Sheet")
    assert texture.GetPath() == "/Root/Sheet/paint_baked/normal_map"


def test_map_of_the_input_that_is_missing_says_so(tmp_path):
    stage = sheet_stage(tmp_path / "in.usda")
    material = define_material(stage, "/Root/paint")
    add_map(material, "./bumps.png")
    bind(stage.GetPrimAtPath("/Root/Sheet"), material)
    stage.Save()
    report = bake(tmp_path / "in.usda", tmp_path / "out.usda")
    lines = [line for line in report.prims[0].problems if "no normal map" in line]
    assert lines == ["/Root/Sheet: no normal map: the normal map of /Root/paint, ./bumps.png, is missing"]


def test_map_lies_on_the_coordinates_that_the_material_uses(tmp_path):
    Image.new("RGB", (4, 4), (10, 20, 30)).save(tmp_path / "color.png")
    stage = sheet_stage(tmp_path / "in.usda", uv_name="lightmap")
    points = bumpy_points()
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Sheet"))
    other = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, "vertex")
    other.Set(Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(points[:, :2] * 5)))
    bind(mesh.GetPrim(), define_material(stage, "/Root/paint", "./color.png", "lightmap"))
    stage.Save()
    out = baked(tmp_path / "in.usda", tmp_path / "out.usda")
    reader = normal_texture(out, "/Root/Sheet").GetInput("st").GetConnectedSources()[0][0].source
    assert UsdShade.Shader(reader.GetPrim()).GetInput("varname").Get() == "lightmap"


def test_mesh_without_a_material_keeps_its_colour(tmp_path):
    stage = sheet_stage(tmp_path / "in.usda")
    UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Sheet")).CreateDisplayColorAttr([(1, 0, 0)])
    stage.Save()
    out = baked(tmp_path / "in.usda", tmp_path / "out.usda")
    material = UsdShade.MaterialBindingAPI(out.GetPrimAtPath("/Root/Sheet")).ComputeBoundMaterial()[0]
    color = material.ComputeSurfaceSource()[0].GetInput("diffuseColor").GetConnectedSources()[0][0].source
    assert UsdShade.Shader(color.GetPrim()).GetInput("varname").Get() == "displayColor"


def test_package_holds_the_map(tmp_path):
    sheet_stage(tmp_path / "in.usda")
    stage = baked(tmp_path / "in.usda", tmp_path / "out.usdz")
    file = map_file(stage, "/Root/Sheet")
    assert Ar.SplitPackageRelativePathInner(file)[1] == "textures/Sheet_normal.png"
    assert not (tmp_path / "out_textures").exists()


def test_flat_file_has_the_map_beside_it(tmp_path):
    sheet_stage(tmp_path / "in.usda")
    stage = baked(tmp_path / "in.usda", tmp_path / "out.usda", flatten=True)
    assert map_file(stage, "/Root/Sheet") == str(tmp_path / "out_textures" / "Sheet_normal.png")
    assert normal_texture(stage, "/Root/Sheet").GetInput("file").Get().path == "./out_textures/Sheet_normal.png"


def test_nothing_temporary_is_left_and_the_input_is_as_it_was(tmp_path):
    sheet_stage(tmp_path / "in.usda")
    before = (tmp_path / "in.usda").read_bytes()
    baked(tmp_path / "in.usda", tmp_path / "out.usda")
    assert (tmp_path / "in.usda").read_bytes() == before
    assert {path.name for path in tmp_path.iterdir()} == {"in.usda", "out.usda", "out_textures"}
    assert {path.name for path in (tmp_path / "out_textures").iterdir()} == {"Sheet_normal.png"}


@pytest.mark.parametrize("name", ["out.usda", "out.usdz"])
def test_second_run_gives_the_same_bytes_and_replaces_the_first(name, tmp_path):
    sheet_stage(tmp_path / "in.usda")

    def digests() -> dict[str, str]:
        baked(tmp_path / "in.usda", tmp_path / name)
        files = [path for path in tmp_path.rglob("*") if path.is_file()]
        return {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}

    assert digests() == digests()


def test_map_takes_the_place_of_no_file_that_is_read(tmp_path):
    (tmp_path / "out_textures").mkdir()
    Image.new("RGB", (4, 4)).save(tmp_path / "out_textures" / "Sheet_normal.png")
    stage = sheet_stage(tmp_path / "in.usda")
    material = define_material(stage, "/Root/paint", "./out_textures/Sheet_normal.png")
    bind(stage.GetPrimAtPath("/Root/Sheet"), material)
    stage.Save()
    before = (tmp_path / "out_textures" / "Sheet_normal.png").read_bytes()
    with pytest.raises(OptionError, match=r"Sheet_normal\.png"):
        bake(tmp_path / "in.usda", tmp_path / "out.usda")
    assert (tmp_path / "out_textures" / "Sheet_normal.png").read_bytes() == before
    assert not (tmp_path / "out.usda").exists()


def test_layer_as_output_is_refused(tmp_path):
    sheet_stage(tmp_path / "in.usda")
    with pytest.raises(OptionError, match="bake_normals: needs a file as output"):
        bake(tmp_path / "in.usda", Sdf.Layer.CreateAnonymous())


@pytest.mark.parametrize("name", ["out.usda", "out.usdz"])
def test_levels_have_a_map_each(name, tmp_path):
    stage = sheet_stage(tmp_path / "in.usda")
    bind(stage.GetPrimAtPath("/Root/Sheet"), define_material(stage, "/Root/paint"))
    stage.Save()
    out = baked(tmp_path / "in.usda", tmp_path / name, ratio=None, lods=(0.4, 0.1))
    files = []
    for level in ("LOD0", "LOD1", "LOD2"):
        out.GetPrimAtPath("/Root").GetVariantSet("LOD").SetVariantSelection(level)
        files.append(map_file(out, "/Root/Sheet"))
        material = UsdShade.MaterialBindingAPI(out.GetPrimAtPath("/Root/Sheet")).ComputeBoundMaterial()[0]
        assert material.ComputeSurfaceSource()[0].GetInput("roughness").Get() == 0.25
    assert files[0] is None
    assert files[1] != files[2]
    if name == "out.usda":
        wanted = [str(tmp_path / "out_textures" / f"LOD{level}_Sheet_normal.png") for level in (1, 2)]
        assert files[1:] == wanted
    assert all(Ar.GetResolver().Resolve(file) for file in files[1:])


def test_levels_of_usd_lod_have_a_map_each(tmp_path):
    pytest.importorskip("pxr.UsdLod")
    stage = sheet_stage(tmp_path / "in.usda")
    bind(stage.GetPrimAtPath("/Root/Sheet"), define_material(stage, "/Root/paint"))
    stage.Save()
    out = baked(tmp_path / "in.usda", tmp_path / "out.usda", ratio=None, lods=(0.4, 0.1), usd_lod=True)
    files = [map_file(out, f"/Root/LOD/LOD{level}/Sheet") for level in (0, 1, 2)]
    wanted = [str(tmp_path / "out_textures" / f"LOD{level}_Sheet_normal.png") for level in (1, 2)]
    assert files == [None, *wanted]
    material = UsdShade.MaterialBindingAPI(out.GetPrimAtPath("/Root/LOD/LOD2/Sheet")).ComputeBoundMaterial()[0]
    assert material.ComputeSurfaceSource()[0].GetInput("roughness").Get() == 0.25


def test_level_files_have_maps_of_their_own(tmp_path):
    sheet_stage(tmp_path / "in.usda")
    bake(tmp_path / "in.usda", tmp_path / "out.usda", ratio=None, lods=(0.4, 0.1), lod_files=True)
    for level in (1, 2):
        stage = Usd.Stage.Open(str(tmp_path / f"out_LOD{level}.usda"))
        assert map_file(stage, "/Root/Sheet") == str(tmp_path / f"out_LOD{level}_textures" / "Sheet_normal.png")


@pytest.mark.parametrize("flatten", [False, True])
def test_instances_show_the_map(flatten, tmp_path):
    stage = sheet_stage(tmp_path / "in.usda")
    define_sheet(stage, "/Proto/Sheet")
    bind(stage.GetPrimAtPath("/Proto/Sheet"), define_material(stage, "/Proto/paint"))
    stage.GetPrimAtPath("/Proto").SetSpecifier(Sdf.SpecifierClass)
    for name in ("one", "other"):
        prim = UsdGeom.Xform.Define(stage, f"/Root/{name}").GetPrim()
        prim.GetReferences().AddInternalReference("/Proto")
        prim.SetInstanceable(True)
    stage.Save()
    out = baked(tmp_path / "in.usda", tmp_path / "out.usda", flatten=flatten)
    for name in ("one", "other"):
        assert out.GetPrimAtPath(f"/Root/{name}").IsInstance()
        file = map_file(out, f"/Root/{name}/Sheet")
        assert file is not None
        assert Path(file).is_file()
        prim = out.GetPrimAtPath(f"/Root/{name}/Sheet")
        material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
        assert material.ComputeSurfaceSource()[0].GetInput("roughness").Get() == 0.25


@pytest.mark.parametrize("bake_skin", [False, True])
def test_skinned_mesh_has_a_map(bake_skin, tmp_path):
    stage = skinned_stage(tmp_path / "in.usda")
    mesh = next(UsdGeom.Mesh(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh))
    points = np.array(mesh.GetPointsAttr().Get())[:, :2]
    uvs = ((points - points.min(axis=0)) / np.ptp(points, axis=0)).astype(np.float32)
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, "vertex")
    primvar.Set(Vt.Vec2fArray.FromNumpy(uvs))
    stage.Save()
    out = baked(tmp_path / "in.usda", tmp_path / "out.usda", ratio=0.5, bake=bake_skin, normals="fit")
    vectors = map_vectors(map_file(out, str(mesh.GetPath())))
    assert np.abs(vectors[..., :2]).max() > 0.02
    assert (vectors[..., 2] > 0.3).all()


@pytest.mark.parametrize("find", [usd_findings, nvidia_findings])
@pytest.mark.parametrize("name", ["out.usda", "out.usdz"])
def test_validators_find_nothing_new(name, find, tmp_path):
    Image.new("RGB", (4, 4), (10, 20, 30)).save(tmp_path / "color.png")
    stage = subset_stage(tmp_path / "in.usda")
    define_sheet(stage, "/Root/Bare")
    bind(stage.GetPrimAtPath("/Root/Sheet"), define_material(stage, "/Root/wood", "./color.png"))
    stage.Save()
    baked(tmp_path / "in.usda", tmp_path / name)
    assert new_findings(tmp_path / "in.usda", tmp_path / name, find) == {}


def test_mesh_whose_topology_varies_says_so(tmp_path):
    capture(tmp_path / "in.usda", [8, 12], 2)
    report = bake(tmp_path / "in.usda", tmp_path / "out.usda", ratio=0.5)
    lines = [line for prim in report.prims for line in prim.problems if "no normal map" in line]
    assert [line.partition(": ")[2] for line in lines] == ["no normal map: its topology varies over time"]


def test_mesh_that_is_kept_has_no_map(tmp_path):
    sheet_stage(tmp_path / "in.usda")
    report = bake(tmp_path / "in.usda", tmp_path / "out.usda", ratio=1.0)
    assert (report.prims[0].status, report.prims[0].problems, report.prims[0].notes) == ("kept", [], [])
    assert not (tmp_path / "out_textures").exists()


def test_mesh_files_hold_no_map(tmp_path):
    define = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n"
    (tmp_path / "in.obj").write_text(define)
    with pytest.raises(OptionError, match="bake_normals"):
        simplify_mesh_files(
            tmp_path / "in.obj", tmp_path / "out.obj", SimplifyOptions(ratio=0.5, bake_normals=SIZE, device="cpu")
        )


def test_command_line_and_manifest_take_the_option(tmp_path):
    sheet_stage(tmp_path / "in.usda")
    arguments = [str(tmp_path / "in.usda"), "-o", str(tmp_path / "out.usda"), "--ratio", "0.2", "--device", "cpu"]
    done = CliRunner().invoke(app, ["simplify", *arguments, "--bake-normals", str(SIZE)])
    assert done.exit_code == 0, done.output
    assert f"normal map of {SIZE} x {SIZE} texels" in " ".join(done.output.split())
    (tmp_path / "jobs.jsonl").write_text(json.dumps({"input": "in.usda", "ratio": 0.2, "bake_normals": SIZE}))
    (job,) = read_manifest(tmp_path / "jobs.jsonl", tmp_path / "out", {})
    assert job.options.bake_normals == SIZE


@pytest.mark.parametrize("size", [0, 7, 20000, 12.5, "big"])
def test_size_of_a_map_is_checked(size):
    with pytest.raises(OptionError, match="bake_normals"):
        SimplifyOptions(ratio=0.5, bake_normals=size)


def test_picture_shows_the_map(tmp_path):
    given = sheet_stage(tmp_path / "in.usda")
    UsdGeom.Mesh(given.GetPrimAtPath("/Root/Sheet")).CreateDisplayColorAttr([(0.5, 0.5, 0.5)])
    given.Save()
    stage = baked(tmp_path / "in.usda", tmp_path / "out.usda", ratio=0.03, normals="none")
    pictures = []
    for source, textures in ((stage, NormalTextures()), (stage, None)):
        drawn = WorldMeshes("out.usda", stage=source)
        points, faces = drawn.read(None)
        view = View(10.0, 20.0, (0.5, 0.5, 0.0), 1.2)
        pictures.append(
            render(points[0], faces, view, size=(96, 96), smooth=True, look=drawn.look(None, Materials(), textures))
        )
    original = WorldMeshes("in.usda", stage=given)
    points, faces = original.read(None)
    wanted = render(points[0], faces, view, size=(96, 96), smooth=True, look=original.look(None, Materials()))
    with_map, without = (np.abs(picture.astype(float) - wanted)[24:72, 24:72].mean() for picture in pictures)
    assert with_map < 0.5 * without
