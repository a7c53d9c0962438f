"""Textures that cannot be found are named, with prim, attribute and path as it is written."""

from __future__ import annotations

from pathlib import Path

import pytest
from pxr import Sdf, Usd, UsdLux, UsdShade

from tests.support.cli import run
from tests.support.usd_stages import cloth_stage
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.read.missing_textures import MAX_LINES, missing_lines, missing_textures

ASSET = Sdf.ValueTypeNames.Asset
FILE = "/Root/Look/Image.inputs:file"


def textured(path: Path, name: str, *, times: tuple[float, ...] = ()) -> Usd.Stage:
    """A cloth whose material has a texture of that name."""
    stage = cloth_stage(path)
    material = UsdShade.Material.Define(stage, "/Root/Look")
    surface = UsdShade.Shader.Define(stage, "/Root/Look/Surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    image = UsdShade.Shader.Define(stage, "/Root/Look/Image")
    image.CreateIdAttr("UsdUVTexture")
    file = image.CreateInput("file", ASSET)
    for time in times or (Usd.TimeCode.Default(),):
        file.Set(name, time)
    output = image.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
    surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(output)
    material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", Sdf.ValueTypeNames.Token))
    UsdShade.MaterialBindingAPI.Apply(stage.GetPrimAtPath("/Root/Cloth")).Bind(material)
    stage.Save()
    return stage


def lines(stage: Usd.Stage) -> list[str]:
    return missing_lines(missing_textures(stage))


@pytest.mark.parametrize("times", [(), (1.0, 2.0)])
@pytest.mark.parametrize("name", ["./tex/skin ü.png", "skin.png", "../skin.<UDIM>.exr"])
def test_file_that_is_not_there_is_named_as_it_is_written(tmp_path, name, times):
    assert lines(textured(tmp_path / "in.usda", name, times=times)) == [f"{FILE}: file {name} cannot be found"]


@pytest.mark.parametrize(("name", "file"), [("./a b.png", "a b.png"), ("./t.<UDIM>.png", "t.1002.png"), ("", "")])
def test_file_that_is_there_or_none_is_not_named(tmp_path, name, file):
    if file:
        (tmp_path / file).write_bytes(b"")
    assert lines(textured(tmp_path / "in.usda", name)) == []


def test_inputs_of_materials_and_lights_are_looked_at_and_other_attributes_are_not(tmp_path):
    stage = textured(tmp_path / "in.usda", "")
    UsdShade.Material(stage.GetPrimAtPath("/Root/Look")).CreateInput("map", ASSET).Set("./map.png")
    UsdLux.DomeLight.Define(stage, "/Root/Sky").CreateTextureFileAttr("sky.exr")
    stage.GetPrimAtPath("/Root/Cloth").CreateAttribute("studio:notes", ASSET).Set("./notes.txt")
    assert lines(stage) == [
        "/Root/Look.inputs:map: file ./map.png cannot be found",
        "/Root/Sky.inputs:texture:file: file sky.exr cannot be found",
    ]


def test_a_stronger_layer_that_names_what_is_there_is_what_counts(tmp_path):
    textured(tmp_path / "in.usda", "./gone.png")
    (tmp_path / "here.png").write_bytes(b"")
    over = Usd.Stage.CreateNew(str(tmp_path / "over.usda"))
    over.GetRootLayer().subLayerPaths.append("./in.usda")
    over.OverridePrim("/Root/Look/Image").CreateAttribute("inputs:file", ASSET).Set("./here.png")
    assert lines(over) == []


def test_files_of_many_attributes_and_instances_are_one_line_each(tmp_path):
    stage = textured(tmp_path / "in.usda", "./gone.png")
    for index in range(3):
        image = UsdShade.Shader.Define(stage, f"/Root/Look/Other{index}")
        image.CreateInput("file", ASSET).Set("./gone.png")
    stage.Save()
    crowd = Usd.Stage.CreateInMemory()
    for index in range(3):
        prim = crowd.DefinePrim(f"/I{index}", "Xform")
        prim.GetReferences().AddReference(str(tmp_path / "in.usda"))
        prim.SetInstanceable(True)
    assert lines(crowd) == ["/I0/Look/Image.inputs:file: file ./gone.png cannot be found (and for 3 more)"]
    for index in range(MAX_LINES + 4):
        UsdShade.Shader.Define(stage, f"/Root/Look/More{index}").CreateInput("file", ASSET).Set(f"./more{index}.png")
    assert len(lines(stage)) == MAX_LINES + 1
    assert lines(stage)[-1] == "and 5 more files that materials and lights name cannot be found"


def test_info_simplify_batch_and_render_name_it(tmp_path):
    textured(tmp_path / "in.usda", "./gone.png")
    text = f"{FILE}: file ./gone.png cannot be found"
    report = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(ratio=0.5, device="cpu"))
    assert report.problems == [text]
    for command in (
        ("info", tmp_path / "in.usda"),
        ("simplify", tmp_path / "in.usda", "-o", tmp_path / "out.usda", "--ratio", "0.5", "--device", "cpu"),
        ("render", tmp_path / "in.usda", "-o", tmp_path / "a.png", "--pictures", "1", "--device", "cpu"),
    ):
        done = run(*command)
        assert done.exit_code == 0
        assert done.stderr.count(text) == 1, command
