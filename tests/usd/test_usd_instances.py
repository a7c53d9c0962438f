"""Meshes below instances: of other files, of other variants, in each other, of what is inactive where it is written."""

from __future__ import annotations

import pytest
from pxr import Sdf, Usd, UsdGeom, UsdSkel

from tests.support.usd_checks import check_stage, compare_properties
from tests.support.usd_composition import clip_stage, convert
from tests.support.usd_instances import faces_at, instance, scene_of, tile_file
from tests.support.usd_stages import FRAMES, cloth_stage, define_cloth, define_skinned
from warpqem.usd.commands.compare import CompareOptions, compare_stages

SHAPE = {"points", "faceVertexCounts", "faceVertexIndices", "extent", "primvars:st", "indices", "normals"}


def test_instances_of_another_file_are_simplified_and_stay_instances(tmp_path, flatten):
    scene_of(tmp_path)
    (tmp_path / "out").mkdir()
    result, report = convert(tmp_path / "in.usda", tmp_path / "out" / "out.usda", flatten=flatten)
    [prim] = report.prims
    assert (prim.path, prim.status, prim.faces_after) == ("/Set/First/Cloth", "simplified", 51)
    check_stage(result)
    [prototype] = result.GetPrototypes()
    assert len(prototype.GetInstances()) == 2
    place = "the new meshes below /Set/First and 1 more instances come from the class /Simplified_Prototype_1"
    assert report.notes == ([] if flatten else [place])
    assert faces_at(result, "/Set/First/Cloth") == faces_at(result, "/Set/Second/Cloth") == 51
    verdicts = compare_properties(Usd.Stage.Open(str(tmp_path / "in.usda")), result)
    assert {path.rsplit(".", 1)[-1] for path in verdicts} <= SHAPE | {"primvars:st:indices"}, verdicts


def test_flat_file_of_instances_needs_no_other(tmp_path):
    scene_of(tmp_path)
    convert(tmp_path / "in.usda", tmp_path / "out.usdc", flatten=True)
    for name in ("in.usda", "tile.usda"):
        (tmp_path / name).unlink()
    result = Usd.Stage.Open(str(tmp_path / "out.usdc"))
    assert faces_at(result, "/Set/Second/Cloth") == 51
    # Nothing is left of what the instances inherited on the way.
    assert [str(prim.GetPath()) for prim in result.GetPseudoRoot().GetAllChildren()] == [
        "/Flattened_Prototype_1",
        "/Set",
    ]


def test_simplified_instances_can_be_compared_and_simplified_again(tmp_path):
    scene_of(tmp_path)
    convert(tmp_path / "in.usda", tmp_path / "out.usda")
    [pair] = compare_stages(tmp_path / "in.usda", tmp_path / "out.usda", CompareOptions(samples=200, device="cpu"))
    assert pair.comparison is not None
    result, report = convert(tmp_path / "out.usda", tmp_path / "again.usda")
    assert report.prims[0].faces_before == 51
    assert faces_at(result, "/Set/Second/Cloth") == report.prims[0].faces_after < 50


def test_only_the_chosen_instances_change(tmp_path):
    scene_of(tmp_path)
    result, report = convert(tmp_path / "in.usda", tmp_path / "out.usda", prims=("/Set/Second",))
    assert [prim.path for prim in report.prims] == ["/Set/Second/Cloth"]
    assert (faces_at(result, "/Set/First/Cloth"), faces_at(result, "/Set/Second/Cloth")) == (64, 51)


def test_instances_of_another_variant_show_that_variant(tmp_path, flatten):
    stage = Usd.Stage.CreateNew(str(tmp_path / "in.usda"))
    looks = stage.DefinePrim("/A/Thing", "Xform").GetVariantSets().AddVariantSet("look")
    for name, size in (("flat", 4), ("bumpy", 6)):
        looks.AddVariant(name)
        looks.SetVariantSelection(name)
        with looks.GetVariantEditContext():
            mesh = define_cloth(stage, "/A/Thing/Tile", size=size)
            if name == "flat":
                # What the other variant has none of must not show on it.
                primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("heat", Sdf.ValueTypeNames.FloatArray, "vertex")
                primvar.Set([1.0] * 25)
    looks.SetVariantSelection("flat")
    for name in ("Copy1", "Copy2"):
        instance(stage, f"/A/{name}", "", "/A/Thing").GetVariantSet("look").SetVariantSelection("bumpy")
    stage.Save()
    result, report = convert(tmp_path / "in.usda", tmp_path / "out.usda", flatten=flatten)
    assert [(prim.path, prim.faces_before, prim.faces_after) for prim in report.prims] == [
        ("/A/Thing/Tile", 32, 13), ("/A/Copy1/Tile", 72, 29)
    ]  # fmt: skip
    check_stage(result)
    for name, count in (("Thing", 13), ("Copy1", 29), ("Copy2", 29)):
        assert faces_at(result, f"/A/{name}/Tile") == count
        heat = result.GetPrimAtPath(f"/A/{name}/Tile").GetAttribute("primvars:heat")
        assert (heat.Get() is not None) == (name == "Thing")


def test_copy_that_has_nothing_to_remove_does_not_show_the_edits_of_its_source(tmp_path):
    stage = Usd.Stage.CreateNew(str(tmp_path / "in.usda"))
    looks = stage.DefinePrim("/Thing", "Xform").GetVariantSets().AddVariantSet("look")
    for name, size in (("fine", 6), ("card", 1)):
        looks.AddVariant(name)
        looks.SetVariantSelection(name)
        with looks.GetVariantEditContext():
            define_cloth(stage, "/Thing/Tile", size=size)
    looks.SetVariantSelection("fine")
    for name in ("Instance", "Copy"):
        prim = instance(stage, f"/{name}", "", "/Thing")
        prim.GetVariantSet("look").SetVariantSelection("card")
        prim.SetInstanceable(name == "Instance")
    stage.Save()
    result, report = convert(tmp_path / "in.usda", tmp_path / "out.usda", ratio=None, faces=30)
    kept = {prim.path: prim.status for prim in report.prims}
    assert kept == {"/Thing/Tile": "simplified", "/Copy/Tile": "kept", "/Instance/Tile": "kept"}
    check_stage(result)
    for name in ("Instance", "Copy"):
        assert faces_at(result, f"/{name}/Tile") == 1
        assert len(UsdGeom.Mesh(result.GetPrimAtPath(f"/{name}/Tile")).GetPointsAttr().Get()) == 4


def test_instances_of_what_is_inactive_are_simplified(tmp_path, flatten):
    stage = cloth_stage(tmp_path / "in.usda")
    define_cloth(stage, "/Off/Tile")
    prim = instance(stage, "/Root/On", "", "/Off")
    prim.SetActive(True)
    stage.GetPrimAtPath("/Off").SetActive(False)
    stage.Save()
    result, report = convert(tmp_path / "in.usda", tmp_path / "out.usda", flatten=flatten)
    assert [(prim.path, prim.status) for prim in report.prims] == [
        ("/Root/Cloth", "simplified"), ("/Root/On/Tile", "simplified")
    ]  # fmt: skip
    assert faces_at(result, "/Root/On/Tile") == 51
    assert result.GetPrimAtPath("/Root/On").IsInstance()
    check_stage(result)


def test_instances_within_instances_are_simplified_once(tmp_path, flatten):
    tile_file(tmp_path / "tile.usda")
    group = Usd.Stage.CreateNew(str(tmp_path / "group.usda"))
    group.SetDefaultPrim(group.DefinePrim("/Group", "Xform"))
    define_cloth(group, "/Group/Own", size=6)
    for name in ("Left", "Right"):
        instance(group, f"/Group/{name}", "./tile.usda")
    group.Save()
    stage = Usd.Stage.CreateNew(str(tmp_path / "in.usda"))
    for name in ("First", "Second"):
        instance(stage, f"/Set/{name}", "./group.usda")
    instance(stage, "/Set/Single", "./tile.usda")
    stage.Save()
    result, report = convert(tmp_path / "in.usda", tmp_path / "out.usda", flatten=flatten)
    assert {(prim.path, prim.faces_after) for prim in report.prims} == {
        ("/Set/First/Own", 29), ("/Set/Single/Cloth", 51)
    }  # fmt: skip
    check_stage(result)
    for place in ("First", "Second", "First/Left", "Single"):
        assert result.GetPrimAtPath(f"/Set/{place}").IsInstance()
    for place in ("First/Left", "First/Right", "Second/Left", "Second/Right", "Single"):
        assert faces_at(result, f"/Set/{place}/Cloth") == 51
    assert faces_at(result, "/Set/Second/Own") == 29


def test_mesh_that_is_an_instance_gets_its_subsets(tmp_path, flatten):
    tile_file(tmp_path / "tile.usda")
    stage = Usd.Stage.CreateNew(str(tmp_path / "in.usda"))
    mesh = UsdGeom.Mesh.Define(stage, "/Tile").GetPrim()
    mesh.GetReferences().AddReference("./tile.usda", "/Root/Cloth")
    mesh.SetInstanceable(True)
    stage.Save()
    result, report = convert(tmp_path / "in.usda", tmp_path / "out.usda", flatten=flatten)
    assert report.prims[0].status == "simplified"
    check_stage(result)
    indices = UsdGeom.Subset(result.GetPrimAtPath("/Tile/half")).GetIndicesAttr().Get()
    assert 0 < len(indices) < 50


@pytest.mark.parametrize("bake", [False, True])
def test_skinned_instances_of_another_file_keep_or_lose_their_skin(bake, tmp_path, flatten):
    asset = Usd.Stage.CreateNew(str(tmp_path / "char.usda"))
    define_skinned(asset)
    asset.SetDefaultPrim(asset.GetPrimAtPath("/Char"))
    asset.Save()
    stage = Usd.Stage.CreateNew(str(tmp_path / "in.usda"))
    for name in ("First", "Second"):
        instance(stage, f"/Set/{name}", "./char.usda")
    stage.Save()
    result, report = convert(tmp_path / "in.usda", tmp_path / "out.usda", flatten=flatten, bake=bake)
    [prim] = report.prims
    assert (prim.status, prim.frames) == ("simplified", 3)
    check_stage(result)
    for name in ("First", "Second"):
        mesh = result.GetPrimAtPath(f"/Set/{name}/Body")
        assert faces_at(result, f"/Set/{name}/Body") == prim.faces_after
        assert (UsdGeom.Mesh(mesh).GetPointsAttr().GetTimeSamples() == FRAMES) == bake
        cache = UsdSkel.Cache()
        cache.Populate(UsdSkel.Root(result.GetPrimAtPath(f"/Set/{name}")), Usd.TraverseInstanceProxies())
        query = cache.GetSkinningQuery(mesh)
        assert bool(query and query.HasJointInfluences() and query.HasBlendShapes()) == (not bake)


def test_clips_of_instances_are_refused_as_usd_ignores_them(tmp_path):
    clip_stage(tmp_path)
    stage = cloth_stage(tmp_path / "scene.usda")
    for name in ("First", "Second"):
        instance(stage, f"/Root/{name}", "./in.usda")
    stage.Save()
    assert not UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Second/Cloth")).GetPointsAttr().GetTimeSamples()
    _result, report = convert(tmp_path / "scene.usda", tmp_path / "out.usda")
    assert [prim.status for prim in report.prims] == ["simplified", "failed"]
    assert "opinions or clips below the instance /Root/First that USD ignores" in report.prims[1].message


def test_names_of_classes_that_are_taken_are_left(tmp_path):
    stage = scene_of(tmp_path)
    stage.DefinePrim("/Simplified_Prototype_1")
    stage.Save()
    result, _report = convert(tmp_path / "in.usda", tmp_path / "out.usda")
    assert result.GetPrimAtPath("/Simplified_Prototype_2").IsAbstract()
    assert faces_at(result, "/Set/Second/Cloth") == 51
