"""Meshes that come through references, payloads, sublayers, variants, value clips, instances and packages."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdUtils

from tests.support.usd_checks import check_stage, compare_properties
from tests.support.usd_composition import CLOTH, clip_stage, convert
from tests.support.usd_stages import FRAMES, cloth_stage, define_cloth
from warpqem.usd.checks.input_check import check_composition

SHAPE = {"points", "faceVertexCounts", "faceVertexIndices", "extent", "velocities", "primvars:heat", "primvars:st"}


def assert_only_the_shape_changed(source: Path, output: Usd.Stage) -> None:
    before = Usd.Stage.Open(str(source))
    check_stage(output)
    verdicts = compare_properties(before, output)
    assert verdicts
    assert {path.rsplit(".", 1)[-1] for path in verdicts} <= SHAPE | {"primvars:st:indices"}, verdicts


def asset(folder: Path) -> Path:
    """A file with a cloth that has a value at each point, in a folder of its own."""
    (folder / "assets").mkdir()
    stage = cloth_stage(folder / "assets" / "cloth.usda")
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH))
    heat = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("heat", Sdf.ValueTypeNames.FloatArray, "vertex")
    heat.Set([float(i) for i in range(81)])
    stage.Save()
    return folder / "assets" / "cloth.usda"


def points_of(stage: Usd.Stage, path: str, time: float) -> np.ndarray:
    return np.array(UsdGeom.Mesh(stage.GetPrimAtPath(path)).GetPointsAttr().Get(time))


@pytest.mark.parametrize("arc", ["reference", "payload", "sublayer", "inherit", "specialize"])
@pytest.mark.parametrize("suffix", [".usda", ".usdc"])
def test_mesh_from_elsewhere_is_edited_by_the_layer(arc, suffix, tmp_path, flatten):
    path = asset(tmp_path)
    stage = Usd.Stage.CreateNew(str(tmp_path / "in.usda"))
    if arc == "sublayer":
        stage.GetRootLayer().subLayerPaths.append("./assets/cloth.usda")
    elif arc in ("reference", "payload"):
        root = stage.DefinePrim("/Root")
        (root.GetReferences().AddReference if arc == "reference" else root.GetPayloads().AddPayload)(str(path))
    else:
        stage.CreateClassPrim("/_base").GetReferences().AddReference(str(path))
        root = stage.DefinePrim("/Root", "Xform")
        (root.GetInherits().AddInherit if arc == "inherit" else root.GetSpecializes().AddSpecialize)("/_base")
    stage.Save()
    result, report = convert(tmp_path / "in.usda", tmp_path / f"out{suffix}", flatten=flatten)
    assert [(prim.path, prim.status, prim.faces_after) for prim in report.prims] == [(CLOTH, "simplified", 51)]
    assert_only_the_shape_changed(tmp_path / "in.usda", result)


def test_samples_behind_a_layer_offset_stay_where_they_are(tmp_path, flatten):
    asset(tmp_path)
    layer = Sdf.Layer.CreateNew(str(tmp_path / "in.usda"))
    layer.subLayerPaths.append("./assets/cloth.usda")
    layer.subLayerOffsets[0] = Sdf.LayerOffset(100, 2)
    layer.Save()
    result, _report = convert(tmp_path / "in.usda", tmp_path / "out.usda", flatten=flatten)
    times = UsdGeom.Mesh(result.GetPrimAtPath(CLOTH)).GetPointsAttr().GetTimeSamples()
    # The asset has 30 time codes a second and the layer above 24, which USD adjusts for.
    assert times == pytest.approx([100 + 2 * 0.8 * time for time in FRAMES])
    assert_only_the_shape_changed(tmp_path / "in.usda", result)


def test_mesh_of_the_selected_variant_is_done_and_the_choice_stays(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    cut = stage.GetPrimAtPath("/Root").GetVariantSets().AddVariantSet("cut")
    for name in ("long", "short"):
        cut.AddVariant(name)
        cut.SetVariantSelection(name)
        with cut.GetVariantEditContext():
            define_cloth(stage, f"/Root/Flag_{name}", times=FRAMES)
    stage.Save()
    result, report = convert(tmp_path / "in.usda", tmp_path / "out.usda")
    assert [prim.path for prim in report.prims] == ["/Root/Flag_short", CLOTH]
    result.SetEditTarget(result.GetSessionLayer())
    result.GetPrimAtPath("/Root").GetVariantSet("cut").SetVariantSelection("long")
    assert len(UsdGeom.Mesh(result.GetPrimAtPath("/Root/Flag_long")).GetFaceVertexCountsAttr().Get()) == 64


@pytest.mark.parametrize("form", ["layer", "flat", "lods", "usd_lod"])
def test_points_from_value_clips_are_simplified_at_every_time(form, tmp_path):
    if form == "usd_lod":
        pytest.importorskip("pxr.UsdLod", reason="UsdLod is part of USD from 26.08 on")
    source = clip_stage(tmp_path)
    before = Usd.Stage.Open(str(source))
    assert UsdGeom.Mesh(before.GetPrimAtPath(CLOTH)).GetPointsAttr().GetTimeSamples() == [0.0, 1.0, 2.0, 3.0]
    options = {"lods": (0.4,), "ratio": None, "usd_lod": form == "usd_lod"} if "lod" in form else {}
    (tmp_path / "out").mkdir()
    result, report = convert(source, tmp_path / "out" / "out.usda", flatten=form == "flat", **options)
    [prim] = report.prims
    assert (prim.status, prim.frames, prim.dropped) == ("simplified", 4, [])
    path = CLOTH
    if form == "lods":
        result.GetDefaultPrim().GetVariantSet("LOD").SetVariantSelection("LOD1")
    elif form == "usd_lod":
        path = "/Root/LOD/LOD1/Cloth"
    mesh = UsdGeom.Mesh(result.GetPrimAtPath(path))
    check_stage(result)
    for time in range(4):
        assert len(mesh.GetPointsAttr().Get(time)) == prim.vertices_after
        assert np.array(mesh.GetVelocitiesAttr().Get(time)) == pytest.approx(float(time))
        assert np.array(UsdGeom.PrimvarsAPI(mesh).GetPrimvar("heat").Get(time)) == pytest.approx(float(time))
        sources = points_of(before, CLOTH, time)
        assert points_of(result, path, time)[:, 2].max() == pytest.approx(sources[:, 2].max(), abs=0.3)


def test_flat_file_of_value_clips_needs_no_clips(tmp_path):
    source = clip_stage(tmp_path)
    convert(source, tmp_path / "out.usda", flatten=True)
    for clip in range(2):
        (tmp_path / f"clip{clip}.usda").unlink()
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    assert check_composition(stage) == []
    assert not stage.GetPrimAtPath("/Root").HasAuthoredMetadata("clips")
    assert UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)).GetPointsAttr().GetTimeSamples() == [0.0, 1.0, 2.0, 3.0]


def test_mesh_in_a_package_is_edited_by_a_layer_over_it(tmp_path, flatten):
    path = asset(tmp_path)
    assert UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(path)), str(tmp_path / "in.usdz"))
    (tmp_path / "out").mkdir()
    result, _report = convert(tmp_path / "in.usdz", tmp_path / "out" / "out.usda", flatten=flatten)
    assert_only_the_shape_changed(tmp_path / "in.usdz", result)


@pytest.mark.parametrize("specifier", [Sdf.SpecifierDef, Sdf.SpecifierClass, Sdf.SpecifierOver])
@pytest.mark.parametrize("arc", ["reference", "inherit"])
def test_instances_of_a_prim_of_the_file_show_its_edits(specifier, arc, tmp_path, flatten):
    stage = cloth_stage(tmp_path / "in.usda")
    define_cloth(stage, "/Asset/Cloth", times=FRAMES)
    stage.GetPrimAtPath("/Asset").SetSpecifier(specifier)
    for name in ("First", "Second"):
        prim = stage.DefinePrim(f"/Root/{name}", "Xform")
        (prim.GetReferences().AddInternalReference if arc == "reference" else prim.GetInherits().AddInherit)("/Asset")
        prim.SetInstanceable(True)
    stage.Save()
    result, report = convert(tmp_path / "in.usda", tmp_path / "out.usda", flatten=flatten)
    assert {(prim.path, prim.status) for prim in report.prims} == {
        (CLOTH, "simplified"), ("/Asset/Cloth", "simplified")
    }  # fmt: skip
    check_stage(result)
    for name in ("First", "Second"):
        assert result.GetPrimAtPath(f"/Root/{name}").IsInstance()
        mesh = UsdGeom.Mesh(result.GetPrimAtPath(f"/Root/{name}/Cloth"))
        assert len(mesh.GetFaceVertexCountsAttr().Get()) == report.prims[0].faces_after
        np.testing.assert_array_equal(
            points_of(result, f"/Root/{name}/Cloth", 2.0), points_of(result, "/Asset/Cloth", 2.0)
        )


def test_instances_of_an_asset_with_a_local_wrapper_show_its_edits(tmp_path):
    path = asset(tmp_path)
    stage = Usd.Stage.CreateNew(str(tmp_path / "in.usda"))
    stage.CreateClassPrim("/_prop").GetReferences().AddReference(str(path))
    for name in ("First", "Second"):
        prim = stage.DefinePrim(f"/{name}")
        prim.GetReferences().AddInternalReference("/_prop")
        prim.SetInstanceable(True)
    stage.Save()
    result, report = convert(tmp_path / "in.usda", tmp_path / "out.usda")
    assert [(prim.path, prim.status) for prim in report.prims] == [("/_prop/Cloth", "simplified")]
    assert len(UsdGeom.Mesh(result.GetPrimAtPath("/Second/Cloth")).GetFaceVertexCountsAttr().Get()) == 51
