"""Levels of detail as variants, end to end."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdShade, UsdSkel

from tests.support.usd_lods import GALLOP, LEVELS, build_levels, properties, run
from tests.support.usd_stages import FRAMES, cloth_stage, define_cloth, instanced_stage, skinned_stage
from warpqem.errors import OptionError, StageError
from warpqem.usd import FrameRange, SimplifyOptions, simplify_stage
from warpqem.usd.commands.option_checks import read_ratios
from warpqem.usd.read.open_stage import open_stage


def open_level(output: Path, level: int) -> Usd.Stage:
    stage = Usd.Stage.Open(str(output))
    # Stages share the layer of the file, which must stay as it was written.
    stage.SetEditTarget(stage.GetSessionLayer())
    stage.GetDefaultPrim().GetVariantSet("LOD").SetVariantSelection(f"LOD{level}")
    return stage


def assert_levels_equal_plain_runs(source: Path, folder: Path, **options: object) -> None:
    report = build_levels(source, folder / "lods.usda", **options)
    assert {prim.status for prim in report.prims} == {"simplified"}
    for level, ratio in LEVELS:
        plain = SimplifyOptions(**{"ratio": ratio, "device": "cpu", **options})
        simplify_stage(source, folder / "plain.usda", plain)
        expected = properties(Usd.Stage.Open(str(folder / "plain.usda")))
        assert properties(open_level(folder / "lods.usda", level)) == expected
        (folder / "plain.usda").unlink()


def test_every_level_of_a_point_cache_equals_a_plain_run(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    assert_levels_equal_plain_runs(tmp_path / "in.usda", tmp_path)


def test_default_points_of_the_input_do_not_show_through(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    points = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth")).GetPointsAttr()
    points.Set(points.Get(FRAMES[0]))
    stage.Save()
    assert_levels_equal_plain_runs(tmp_path / "in.usda", tmp_path)


def test_every_level_of_a_skinned_mesh_equals_a_plain_run(tmp_path):
    stage = skinned_stage(tmp_path / "in.usda")
    stage.SetDefaultPrim(stage.GetPrimAtPath("/Char"))
    stage.Save()
    assert_levels_equal_plain_runs(tmp_path / "in.usda", tmp_path)


def test_every_level_of_a_baked_skin_equals_a_plain_run(tmp_path):
    stage = skinned_stage(tmp_path / "in.usda")
    stage.SetDefaultPrim(stage.GetPrimAtPath("/Char"))
    stage.Save()
    assert_levels_equal_plain_runs(tmp_path / "in.usda", tmp_path, bake=True)


def test_mesh_that_inherits_within_the_default_prim_shows_its_level(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    define_cloth(stage, "/Root/_cloth", times=FRAMES).GetPrim().SetSpecifier(Sdf.SpecifierClass)
    stage.RemovePrim("/Root/Cloth")
    UsdGeom.Mesh.Define(stage, "/Root/Flag").GetPrim().GetInherits().AddInherit("/Root/_cloth")
    stage.Save()
    assert_levels_equal_plain_runs(tmp_path / "in.usda", tmp_path)


def test_mesh_that_inherits_from_another_root_prim_shows_its_level(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    define_cloth(stage, "/Pattern", times=FRAMES)
    UsdGeom.Mesh.Define(stage, "/Root/Flag").GetPrim().GetInherits().AddInherit("/Pattern")
    stage.Save()
    assert_levels_equal_plain_runs(tmp_path / "in.usda", tmp_path, prims=("/Root",))


def test_mesh_of_a_variant_of_the_input_shows_its_level(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    cut = stage.GetPrimAtPath("/Root").GetVariantSets().AddVariantSet("cut")
    cut.AddVariant("long")
    cut.SetVariantSelection("long")
    with cut.GetVariantEditContext():
        define_cloth(stage, "/Root/Flag", times=FRAMES)
    stage.Save()
    assert_levels_equal_plain_runs(tmp_path / "in.usda", tmp_path)


def test_default_prim_that_is_a_mesh_shows_its_level(tmp_path):
    stage = Usd.Stage.CreateNew(str(tmp_path / "in.usda"))
    stage.SetDefaultPrim(define_cloth(stage, "/Cloth", times=FRAMES).GetPrim())
    stage.Save()
    assert_levels_equal_plain_runs(tmp_path / "in.usda", tmp_path)


def test_only_root_prim_stands_in_for_a_default_prim(tmp_path):
    skinned_stage(tmp_path / "in.usda")
    build_levels(tmp_path / "in.usda", tmp_path / "lods.usda")
    assert Usd.Stage.Open(str(tmp_path / "lods.usda")).GetDefaultPrim().GetPath() == "/Char"


def test_first_level_is_the_input_and_the_default(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    UsdGeom.Camera.Define(stage, "/Camera").CreateFocalLengthAttr(35.0)
    stage.Save()
    build_levels(tmp_path / "in.usda", tmp_path / "lods.usda")
    result = Usd.Stage.Open(str(tmp_path / "lods.usda"))
    assert properties(result) == properties(Usd.Stage.Open(str(tmp_path / "in.usda")))
    assert result.GetTimeCodesPerSecond() == 30
    assert UsdGeom.GetStageUpAxis(result) == UsdGeom.Tokens.z


@pytest.mark.parametrize("local", [True, False])
def test_instances_show_every_level(local, tmp_path):
    instanced_stage(tmp_path / "in.usda", local=local)
    report = build_levels(tmp_path / "in.usda", tmp_path / "lods.usda")
    counts = [64] + [prim.faces_after for prim in report.prims if prim.path == "/Root/First/Cloth"]
    assert len(counts) == 3
    for level, count in enumerate(counts):
        stage = open_level(tmp_path / "lods.usda", level)
        assert len(stage.GetPrototypes()) == 1
        for name in ("First", "Second"):
            assert stage.GetPrimAtPath(f"/Root/{name}").IsInstance()
            mesh = UsdGeom.Mesh(stage.GetPrimAtPath(f"/Root/{name}/Cloth"))
            assert len(mesh.GetFaceVertexCountsAttr().Get()) == count


def test_switching_levels_changes_the_faces_there_and_back(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    report = build_levels(tmp_path / "in.usda", tmp_path / "lods.usdc")
    stage = Usd.Stage.Open(str(tmp_path / "lods.usdc"))
    lods = stage.GetDefaultPrim().GetVariantSet("LOD")
    assert lods.GetVariantNames() == ["LOD0", "LOD1", "LOD2"]
    counts = []
    for name in ("LOD0", "LOD2", "LOD1", "LOD0"):
        lods.SetVariantSelection(name)
        counts.append(len(UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth")).GetFaceVertexCountsAttr().Get()))
    faces = {prim.level: prim.faces_after for prim in report.prims}
    assert counts == [64, faces["LOD2"], faces["LOD1"], 64]
    assert faces["LOD2"] < faces["LOD1"]


def test_level_can_be_chosen_through_a_reference_to_the_output(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    report = build_levels(tmp_path / "in.usda", tmp_path / "lods.usda")
    scene = Usd.Stage.CreateInMemory()
    prim = scene.DefinePrim("/Set/Prop")
    prim.GetReferences().AddReference(str(tmp_path / "lods.usda"))
    prim.GetVariantSet("LOD").SetVariantSelection("LOD1")
    mesh = UsdGeom.Mesh(scene.GetPrimAtPath("/Set/Prop/Cloth"))
    assert len(mesh.GetFaceVertexCountsAttr().Get()) == report.prims[0].faces_after


def test_gallop_stays_skinned_on_every_level(tmp_path):
    start = open_stage(GALLOP).GetStartTimeCode()
    build_levels(GALLOP, tmp_path / "lods.usda", key_frames=2, frames=FrameRange(start, start + 1))
    for level, _ratio in LEVELS:
        stage = Usd.Stage.Open(open_level(tmp_path / "lods.usda", level).Flatten())
        [prim] = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
        point_count = len(UsdGeom.Mesh(prim).GetPointsAttr().Get())
        cache = UsdSkel.Cache()
        cache.Populate(UsdSkel.Root(stage.GetDefaultPrim()), Usd.PrimDefaultPredicate)
        skin = cache.GetSkinningQuery(prim)
        assert skin.HasJointInfluences()
        assert len(skin.ComputeJointInfluences()[0]) == point_count * skin.GetNumInfluencesPerComponent()
        before = np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get())
        assert UsdSkel.BakeSkinning(stage.Traverse())
        assert np.abs(np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get(start)) - before).max() > 0


def test_input_stays_as_it_is_beside_one_new_file(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    before = (tmp_path / "in.usda").read_bytes()
    build_levels(tmp_path / "in.usda", tmp_path / "lods.usda")
    assert (tmp_path / "in.usda").read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in.usda", "lods.usda"]


def test_output_names_the_input_by_a_relative_path(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    (tmp_path / "out").mkdir()
    build_levels(tmp_path / "in.usda", tmp_path / "out" / "lods.usda")
    layer = Sdf.Layer.FindOrOpen(str(tmp_path / "out" / "lods.usda"))
    assert list(layer.GetCompositionAssetDependencies()) == ["../in.usda"]


def test_mesh_that_cannot_be_read_fails_on_every_level(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    define_cloth(stage, "/Root/Broken").GetFaceVertexCountsAttr().Set([4])
    stage.Save()
    report = build_levels(tmp_path / "in.usda", tmp_path / "lods.usda")
    assert [(prim.level, prim.status) for prim in report.prims if prim.path == "/Root/Broken"] == [
        ("LOD1", "failed"), ("LOD2", "failed")
    ]  # fmt: skip


def material_beside(path: Path) -> None:
    """A cloth, and one of a class with two instances, with a material in another root prim."""
    stage = cloth_stage(path)
    material = UsdShade.Material.Define(stage, "/Materials/Red")
    stage.CreateClassPrim("/Asset")
    define_cloth(stage, "/Asset/Flag", times=FRAMES)
    for name in ("First", "Second"):
        prim = stage.DefinePrim(f"/Root/{name}", "Xform")
        prim.GetReferences().AddInternalReference("/Asset")
        prim.SetInstanceable(True)
    for mesh in ("/Root/Cloth", "/Asset/Flag"):
        UsdShade.MaterialBindingAPI.Apply(stage.GetPrimAtPath(mesh)).Bind(material)
    # What another root prim refers to may be on the levels.
    stage.GetPrimAtPath("/Materials").CreateRelationship("seen:by").SetTargets(["/Root/Cloth"])
    stage.Save()


@pytest.mark.filterwarnings("error")
def test_target_beside_the_default_prim_stays_one(tmp_path):
    material_beside(tmp_path / "in.usda")
    build_levels(tmp_path / "in.usda", tmp_path / "lods.usda")
    for level in range(3):
        stage = open_level(tmp_path / "lods.usda", level)
        if hasattr(stage, "GetCompositionErrors"):
            assert stage.GetCompositionErrors() == []
        for mesh in ("Cloth", "First/Flag", "Second/Flag"):
            binding = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath(f"/Root/{mesh}"))
            assert str(binding.ComputeBoundMaterial()[0].GetPath()) == "/Materials/Red"
        assert stage.GetPrimAtPath("/Root/Second").IsInstance()
        assert stage.GetPrimAtPath("/Materials").GetRelationship("seen:by").GetTargets() == ["/Root/Cloth"]


@pytest.mark.parametrize("specifier", ["over", "class"])
def test_collection_on_a_root_prim_that_is_not_shown_binds_on_every_level(specifier, tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    material = UsdShade.Material.Define(stage, "/Root/Red")
    holder = stage.OverridePrim("/Sets") if specifier == "over" else stage.CreateClassPrim("/Sets")
    collection = Usd.CollectionAPI.Apply(holder, "cloth")
    collection.IncludePath("/Root/Cloth")
    UsdShade.MaterialBindingAPI.Apply(stage.GetPrimAtPath("/Root")).Bind(collection, material)
    stage.Save()
    build_levels(tmp_path / "in.usda", tmp_path / "lods.usda")
    for level in range(3):
        result = open_level(tmp_path / "lods.usda", level)
        bound = UsdShade.MaterialBindingAPI(result.GetPrimAtPath("/Root/Cloth"))
        assert str(bound.ComputeBoundMaterial()[0].GetPath()) == "/Root/Red"


def test_mesh_beside_the_default_prim_gets_levels(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    define_cloth(stage, "/Other/Flag")
    stage.Save()
    report = build_levels(tmp_path / "in.usda", tmp_path / "lods.usda")
    result = Usd.Stage.Open(str(tmp_path / "lods.usda"))
    assert str(result.GetDefaultPrim().GetPath()) == "/Root"
    for root, mesh in (("/Root", "/Root/Cloth"), ("/Other", "/Other/Flag")):
        result.GetPrimAtPath(root).GetVariantSet("LOD").SetVariantSelection("LOD1")
        [count] = [prim.faces_after for prim in report.prims if (prim.level, prim.path) == ("LOD1", mesh)]
        assert len(UsdGeom.Mesh(result.GetPrimAtPath(mesh)).GetFaceVertexCountsAttr().Get()) == count


def test_meshes_that_are_not_chosen_have_no_levels(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    define_cloth(stage, "/Other/Flag")
    stage.ClearDefaultPrim()
    stage.Save()
    build_levels(tmp_path / "in.usda", tmp_path / "lods.usda", prims=("/Other",))
    result = Usd.Stage.Open(str(tmp_path / "lods.usda"))
    assert [prim.GetName() for prim in result.GetPseudoRoot().GetChildren() if prim.HasVariantSets()] == ["Other"]
    assert str(result.GetDefaultPrim().GetPath()) == "/Other"


def test_stage_without_meshes_has_no_levels(tmp_path):
    stage = Usd.Stage.CreateNew(str(tmp_path / "in.usda"))
    stage.DefinePrim("/Root")
    stage.Save()
    with pytest.raises(StageError, match="there is no mesh on the stage"):
        build_levels(tmp_path / "in.usda", tmp_path / "lods.usda")


def test_levels_of_levels_are_refused(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    build_levels(tmp_path / "in.usda", tmp_path / "lods.usda")
    with pytest.raises(OptionError, match="/Root has a variant set LOD already"):
        build_levels(tmp_path / "lods.usda", tmp_path / "more.usda")


def test_ratios_are_read_from_text():
    assert read_ratios("0.5, 0.25,.1") == (0.5, 0.25, 0.1)


@pytest.mark.parametrize("ratios", ["", "half", "0.5,", "1", "0.5,0", "-0.1", "nan", "0.5,0.5", "0.25,0.5", "50,25"])
def test_bad_ratios_are_wrong_usage(ratios, tmp_path):
    cloth_stage(tmp_path / "in.usda")
    result = run("simplify", tmp_path / "in.usda", "-o", tmp_path / "out.usda", f"--lods={ratios}")
    assert result.exit_code == 2
    assert result.stderr.startswith("error: --lods")
    assert not (tmp_path / "out.usda").exists()


@pytest.mark.parametrize("option", [("--flatten",), ("--ratio", "0.5"), ("--faces", "9"), ("--max-error", "1")])
def test_options_that_exclude_levels_are_wrong_usage(option, tmp_path):
    cloth_stage(tmp_path / "in.usda")
    result = run("simplify", tmp_path / "in.usda", "-o", tmp_path / "out.usda", "--lods", "0.5", *option)
    assert result.exit_code == 2
    assert "lods" in result.stderr


def test_table_and_json_list_the_faces_of_every_level(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    files = (tmp_path / "in.usda", "-o", tmp_path / "out.usda", "--json", tmp_path / "report.json")
    result = run("simplify", *files, "--lods", "0.5,0.2", "--device", "cpu")
    assert result.exit_code == 0, result.stderr
    prims = json.loads((tmp_path / "report.json").read_text())["prims"]
    assert [(prim["level"], prim["path"]) for prim in prims] == [("LOD1", "/Root/Cloth"), ("LOD2", "/Root/Cloth")]
    rows = [line for line in result.stdout.splitlines() if line.lstrip().startswith("LOD") and "/Root/Cloth" in line]
    for row, prim in zip(rows, prims, strict=True):
        assert prim["level"] in row
        assert str(prim["faces_after"]) in row
