"""Where there can be no normal map: meshes, materials and outputs that say so."""

from __future__ import annotations

import re

import numpy as np
import pytest
from PIL import Image
from pxr import Sdf, Usd, UsdShade

from tests.support.usd_normal_maps import SIZE, bake
from tests.support.usd_textured import (
    add_map,
    bind,
    bumpy_points,
    define_material,
    sheet_stage,
)
from tests.support.usd_topology_runs import capture
from warpqem.errors import OptionError
from warpqem.usd import SimplifyOptions
from warpqem.usd.commands.simplify_meshes import simplify_mesh_files


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


def test_map_of_the_input_that_is_missing_says_so(tmp_path):
    stage = sheet_stage(tmp_path / "in.usda")
    material = define_material(stage, "/Root/paint")
    add_map(material, "./bumps.png")
    bind(stage.GetPrimAtPath("/Root/Sheet"), material)
    stage.Save()
    report = bake(tmp_path / "in.usda", tmp_path / "out.usda")
    lines = [line for line in report.prims[0].problems if "no normal map" in line]
    assert lines == ["/Root/Sheet: no normal map: the normal map of /Root/paint, ./bumps.png, is missing"]


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


def test_mesh_whose_topology_varies_says_so(tmp_path):
    capture(tmp_path / "in.usda", [8, 12], 2)
    report = bake(tmp_path / "in.usda", tmp_path / "out.usda", ratio=0.5)
    lines = [line for prim in report.prims for line in prim.problems if "no normal map" in line]
    assert [line.partition(": ")[2] for line in lines] == ["no normal map: its topology varies over time"]


def test_mesh_that_is_kept_has_no_map_and_says_so(tmp_path):
    sheet_stage(tmp_path / "in.usda")
    report = bake(tmp_path / "in.usda", tmp_path / "out.usda", ratio=1.0)
    assert (report.prims[0].status, report.prims[0].problems) == ("kept", [])
    assert report.prims[0].notes == ["/Root/Sheet: no normal map, as the mesh keeps its faces and its own shading"]
    assert not (tmp_path / "out_textures").exists()


def test_mesh_files_hold_no_map(tmp_path):
    define = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n"
    (tmp_path / "in.obj").write_text(define)
    with pytest.raises(OptionError, match="bake_normals"):
        simplify_mesh_files(
            tmp_path / "in.obj", tmp_path / "out.obj", SimplifyOptions(ratio=0.5, bake_normals=SIZE, device="cpu")
        )


@pytest.mark.parametrize("size", [0, 7, 20000, 12.5, "big"])
def test_size_of_a_map_is_checked(size):
    with pytest.raises(OptionError, match="bake_normals"):
        SimplifyOptions(ratio=0.5, bake_normals=size)
