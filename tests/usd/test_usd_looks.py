"""What meshes of a stage look like: display colours, materials and their textures, normals."""

from __future__ import annotations

import os
import struct
import zlib

import numpy as np
import pytest
from PIL import Image
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, UsdUtils, Vt

from tests.support.usd_stages import cloth_stage, define_cloth
from warpqem.picture.look import PLAIN, Look
from warpqem.usd.read.materials import LARGEST_TEXTURE, Materials
from warpqem.usd.read.world import WorldMeshes

TYPES = Sdf.ValueTypeNames
CLOTH = "/Root/Cloth"


def look_of(stage: Usd.Stage, materials: Materials | None = None) -> Look:
    return WorldMeshes("in.usda", stage=stage).look([1.0], materials or Materials())


def shader(stage: Usd.Stage, path: str, kind: str, **values: object) -> UsdShade.Shader:
    node = UsdShade.Shader.Define(stage, path)
    node.CreateIdAttr(kind)
    for name, (type_name, value) in values.items():
        node.CreateInput(name, type_name).Set(value)
    return node


def surface(stage: Usd.Stage, name: str) -> tuple[UsdShade.Material, UsdShade.Shader]:
    material = UsdShade.Material.Define(stage, f"/Root/{name}")
    node = shader(stage, f"/Root/{name}/Surface", "UsdPreviewSurface")
    material.CreateSurfaceOutput().ConnectToSource(node.ConnectableAPI(), "surface")
    return material, node


def bind(prim: Usd.Prim, material: UsdShade.Material) -> None:
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(material)


def add_st(stage: Usd.Stage, name: str = "st") -> np.ndarray:
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH))
    values = np.array(mesh.GetPointsAttr().Get(1.0))[:, :2].astype(np.float32)
    UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(name, TYPES.TexCoord2fArray, UsdGeom.Tokens.vertex).Set(
        Vt.Vec2fArray.FromNumpy(values)
    )
    return values


def textured(folder, stage: Usd.Stage, size: tuple[int, int] = (4, 2)) -> UsdShade.Material:
    """A material with an image, its file in the interface of the material, on a turned `st`."""
    pixels = np.zeros((size[1], size[0], 3), dtype=np.uint8)
    pixels[0, 0] = [200, 100, 50]
    Image.fromarray(pixels).save(folder / "map.png")
    material, base = surface(stage, "Textured")
    file = material.CreateInput("map", TYPES.Asset)
    file.Set("./map.png")
    image = shader(
        stage, "/Root/Textured/Image", "UsdUVTexture", wrapS=(TYPES.Token, "clamp"), wrapT=(TYPES.Token, "repeat")
    )
    image.CreateInput("file", TYPES.Asset).ConnectToSource(file)
    reader = shader(stage, "/Root/Textured/St", "UsdPrimvarReader_float2", varname=(TYPES.String, "st"))
    turned = shader(
        stage, "/Root/Textured/Turn", "UsdTransform2d",
        rotation=(TYPES.Float, 90.0), scale=(TYPES.Float2, Gf.Vec2f(2, 3)),
        translation=(TYPES.Float2, Gf.Vec2f(0.25, 0.5)),
    )  # fmt: skip
    turned.CreateInput("in", TYPES.Float2).ConnectToSource(reader.ConnectableAPI(), "result")
    image.CreateInput("st", TYPES.Float2).ConnectToSource(turned.ConnectableAPI(), "result")
    base.CreateInput("diffuseColor", TYPES.Color3f).ConnectToSource(image.ConnectableAPI(), "rgb")
    return material


def test_mesh_without_anything_is_plain(tmp_path):
    assert look_of(cloth_stage(tmp_path / "in.usda")).is_plain


def test_display_colours_are_those_of_the_corners(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH))
    count = len(mesh.GetPointsAttr().Get(1.0))
    colors = np.random.default_rng(1).random((count, 3)).astype(np.float32)
    mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex).Set(Vt.Vec3fArray.FromNumpy(colors))
    _, faces = WorldMeshes("in.usda", stage=stage).read([1.0])
    np.testing.assert_array_equal(look_of(stage).colors, colors[faces])


def test_colour_of_a_material_goes_before_display_colours(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH))
    mesh.CreateDisplayColorAttr([(1, 0, 0)])
    material, base = surface(stage, "Green")
    base.CreateInput("diffuseColor", TYPES.Color3f).Set((0.0, 0.5, 0.1))
    bind(mesh.GetPrim(), material)
    assert look_of(stage).colors == pytest.approx(np.broadcast_to([0.0, 0.5, 0.1], (128, 3, 3)))


def test_texture_has_its_image_its_place_and_how_it_repeats(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    st = add_st(stage)
    bind(stage.GetPrimAtPath(CLOTH), textured(tmp_path, stage))
    look = look_of(stage)
    [texture] = look.textures
    assert texture.pixels[0, 0].tolist() == [200, 100, 50]
    assert texture.repeats == (False, True)
    _, faces = WorldMeshes("in.usda", stage=stage).read([1.0])
    # Scaled, then turned by 90 degrees counter-clockwise, then moved.
    scaled = st[faces] * [2, 3]
    assert look.uvs == pytest.approx(np.stack([0.25 - scaled[..., 1], 0.5 + scaled[..., 0]], axis=2), abs=1e-5)
    assert look.colors == pytest.approx(np.ones((128, 3, 3)))


def test_texture_of_a_mesh_without_its_coordinates_is_left_out(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    bind(stage.GetPrimAtPath(CLOTH), textured(tmp_path, stage))
    assert look_of(stage).is_plain


def test_large_images_are_made_smaller(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    add_st(stage)
    bind(stage.GetPrimAtPath(CLOTH), textured(tmp_path, stage, (1200, 600)))
    assert look_of(stage).textures[0].pixels.shape == (LARGEST_TEXTURE // 2, LARGEST_TEXTURE, 3)


@pytest.mark.parametrize("content", [b"", b"no image", b"\x89PNG\r\n\x1a\n" + bytes(40)])
def test_file_that_is_no_image_gives_the_fallback(tmp_path, content):
    stage = cloth_stage(tmp_path / "in.usda")
    add_st(stage)
    bind(stage.GetPrimAtPath(CLOTH), textured(tmp_path, stage))
    UsdShade.Shader(stage.GetPrimAtPath("/Root/Textured/Image")).CreateInput("fallback", TYPES.Float4).Set(
        (0.1, 0.2, 0.3, 1)
    )
    (tmp_path / "map.png").write_bytes(content)
    materials = Materials()
    look = look_of(stage, materials)
    assert not look.textures
    assert look.colors[0, 0] == pytest.approx([0.1, 0.2, 0.3])
    assert materials.left_out == [
        "/Root/Textured: texture ./map.png is not shown: it is missing, or no image that can be read"
    ]


@pytest.mark.parametrize("name", ["./tile.<UDIM>.png", "./missing.png", ""])
def test_texture_that_is_not_found_leaves_the_display_colours_and_a_line(tmp_path, name):
    stage = cloth_stage(tmp_path / "in.usda")
    add_st(stage)
    UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)).CreateDisplayColorAttr([(0.3, 0.2, 0.1)])
    bind(stage.GetPrimAtPath(CLOTH), textured(tmp_path, stage))
    stage.GetPrimAtPath("/Root/Textured").GetAttribute("inputs:map").Set(name)
    materials = Materials()
    assert look_of(stage, materials).colors[0, 0] == pytest.approx([0.3, 0.2, 0.1])
    [line] = materials.left_out
    assert line.startswith(f"/Root/Textured: texture {name or 'none'} is not shown: ")


def test_texture_in_a_package_is_found(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    add_st(stage)
    bind(stage.GetPrimAtPath(CLOTH), textured(tmp_path, stage))
    stage.Save()
    assert UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(tmp_path / "in.usda")), str(tmp_path / "in.usdz"))
    assert look_of(Usd.Stage.Open(str(tmp_path / "in.usdz"))).textures[0].pixels.shape == (2, 4, 3)


def test_equal_images_of_two_files_are_one_texture(tmp_path):
    materials, found = Materials(), []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        stage = cloth_stage(tmp_path / name / "in.usda")
        add_st(stage)
        bind(stage.GetPrimAtPath(CLOTH), textured(tmp_path / name, stage))
        found.append(look_of(stage, materials).textures[0])
    assert found[0] is found[1]


def test_subsets_have_materials_of_their_own(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH))
    material, base = surface(stage, "Blue")
    base.CreateInput("diffuseColor", TYPES.Color3f).Set((0, 0, 1))
    subset = UsdGeom.Subset.CreateGeomSubset(mesh, "Half", UsdGeom.Tokens.face, Vt.IntArray(range(32)), "materialBind")
    bind(subset.GetPrim(), material)
    look = look_of(stage)
    blue = (look.colors == np.float32([0, 0, 1])).all(axis=(1, 2))
    assert blue.sum() == 64
    assert look.colors[~blue] == pytest.approx(np.broadcast_to(PLAIN, (64, 3, 3)))
    assert [part.name for part in look.parts] == [CLOTH, CLOTH]


def test_material_that_reads_a_primvar_shows_it(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH))
    mesh.CreateDisplayColorAttr([(0.3, 0.2, 0.1)])
    material, base = surface(stage, "Painted")
    reader = shader(stage, "/Root/Painted/Color", "UsdPrimvarReader_float3", varname=(TYPES.String, "displayColor"))
    base.CreateInput("diffuseColor", TYPES.Color3f).ConnectToSource(reader.ConnectableAPI(), "result")
    bind(mesh.GetPrim(), material)
    assert look_of(stage).colors[0, 0] == pytest.approx([0.3, 0.2, 0.1])


def test_unknown_shaders_leave_the_display_colours(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)).CreateDisplayColorAttr([(0.3, 0.2, 0.1)])
    material = UsdShade.Material.Define(stage, "/Root/Own")
    node = shader(stage, "/Root/Own/Surface", "StudioSurface")
    material.CreateSurfaceOutput().ConnectToSource(node.ConnectableAPI(), "surface")
    bind(stage.GetPrimAtPath(CLOTH), material)
    assert look_of(stage).colors[0, 0] == pytest.approx([0.3, 0.2, 0.1])


def test_parts_are_named_by_the_places_of_the_meshes(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    define_cloth(stage, "/Root/Other")
    look = look_of(stage)
    assert [part.name for part in look.parts] == [CLOTH, "/Root/Other"]
    assert look.face_part.tolist() == [0] * 128 + [1] * 128


def test_subdivision_surfaces_are_smooth_all_over(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)).CreateSubdivisionSchemeAttr("catmullClark")
    normals = look_of(stage).normals
    assert (normals == normals[0, 0]).all()


@pytest.mark.parametrize(
    ("name", "kind", "value"),
    [
        ("rotation", TYPES.String, "much"),
        ("rotation", TYPES.Float, float("nan")),
        ("scale", TYPES.Float, 3.0),
        ("scale", TYPES.Float2, Gf.Vec2f(float("inf"), 1)),
        ("translation", TYPES.Token, "x"),
    ],
)
def test_transform_that_is_none_is_left_out(tmp_path, name, kind, value):
    stage = cloth_stage(tmp_path / "in.usda")
    add_st(stage)
    bind(stage.GetPrimAtPath(CLOTH), textured(tmp_path, stage))
    node = stage.GetPrimAtPath("/Root/Textured/Turn")
    node.RemoveProperty(f"inputs:{name}")
    UsdShade.Shader(node).CreateInput(name, kind).Set(value)
    assert np.isfinite(look_of(stage).uvs).all()


def test_nodes_in_a_circle_end(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    add_st(stage)
    bind(stage.GetPrimAtPath(CLOTH), textured(tmp_path, stage))
    turn = UsdShade.Shader(stage.GetPrimAtPath("/Root/Textured/Turn"))
    turn.GetInput("in").ConnectToSource(turn.ConnectableAPI(), "result")
    assert len(look_of(stage).textures) == 1


def test_texture_that_is_no_regular_file_is_left_out(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    add_st(stage)
    bind(stage.GetPrimAtPath(CLOTH), textured(tmp_path, stage))
    (tmp_path / "map.png").unlink()
    os.mkfifo(tmp_path / "map.png")
    materials = Materials()
    assert look_of(stage, materials).is_plain
    assert len(materials.left_out) == 1


def test_image_of_huge_size_in_its_head_is_left_out(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    add_st(stage)
    bind(stage.GetPrimAtPath(CLOTH), textured(tmp_path, stage))
    # The size in the head of a PNG, with the checksum that belongs to it.
    content = (tmp_path / "map.png").read_bytes()
    head = b"IHDR" + struct.pack(">II", 20000, 20000) + content[24:29]
    (tmp_path / "map.png").write_bytes(content[:12] + head + struct.pack(">I", zlib.crc32(head)) + content[33:])
    materials = Materials()
    assert look_of(stage, materials).is_plain
    assert len(materials.left_out) == 1
