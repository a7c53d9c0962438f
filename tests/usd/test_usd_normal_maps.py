"""Normal maps baked for meshes of a stage: what is written, how it is wired, and what goes along."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pxr import Ar, Sdf, Usd, UsdGeom, UsdShade, Vt
from typer.testing import CliRunner

from tests.support.usd_findings import nvidia_findings, usd_findings
from tests.support.usd_normal_maps import SIZE, bake, baked
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
from tests.support.usd_validators import new_findings
from warpqem.batching.manifest import read_manifest
from warpqem.cli.main import app
from warpqem.normal_maps.tangents import corner_tangents
from warpqem.picture import View, render
from warpqem.usd.read.materials import Materials
from warpqem.usd.read.normal_textures import NormalTextures
from warpqem.usd.read.world import WorldMeshes


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


def test_empty_material_gets_a_surface(tmp_path):
    stage = sheet_stage(tmp_path / "in.usda")
    bind(stage.GetPrimAtPath("/Root/Sheet"), UsdShade.Material.Define(stage, "/Root/paint"))
    stage.Save()
    out = baked(tmp_path / "in.usda", tmp_path / "out.usda")
    material = UsdShade.MaterialBindingAPI(out.GetPrimAtPath("/Root/Sheet")).ComputeBoundMaterial()[0]
    assert material.GetPrim().GetInherits().GetAllDirectInherits() == ["/Root/paint"]
    assert Path(map_file(out, "/Root/Sheet")).is_file()


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


def test_command_line_and_manifest_take_the_option(tmp_path):
    sheet_stage(tmp_path / "in.usda")
    arguments = [str(tmp_path / "in.usda"), "-o", str(tmp_path / "out.usda"), "--ratio", "0.2", "--device", "cpu"]
    done = CliRunner().invoke(app, ["simplify", *arguments, "--bake-normals", str(SIZE)])
    assert done.exit_code == 0, done.output
    assert f"normal map of {SIZE} x {SIZE} texels" in " ".join(done.output.split())
    (tmp_path / "jobs.jsonl").write_text(json.dumps({"input": "in.usda", "ratio": 0.2, "bake_normals": SIZE}))
    (job,) = read_manifest(tmp_path / "jobs.jsonl", tmp_path / "out", {})
    assert job.options.bake_normals == SIZE


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
