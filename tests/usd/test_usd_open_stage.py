"""Open stages as inputs and layers as outputs: what the stage shows is simplified, and nothing else changes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pxr import Ar, Sdf, Usd, UsdGeom

from tests.support.usd_checks import check_stage
from tests.support.usd_instances import faces_at, scene_of, tile_file
from tests.support.usd_stages import FRAMES, cloth_stage, define_cloth
from warpqem.errors import OptionError, StageError
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.write.stage_report import StageReport

CLOTH = "/Root/Cloth"


def simplify(stage: Usd.Stage | str, output: Any, **options: object) -> StageReport:
    return simplify_stage(stage, output, SimplifyOptions(**{"ratio": 0.4, "device": "cpu", **options}))


def state(stage: Usd.Stage, *left_out: Sdf.Layer) -> list[object]:
    """All layers of a stage but some, with their changes, and all that is set on it."""
    layers = {
        layer.identifier: (layer.ExportToString(), layer.dirty)
        for layer in stage.GetUsedLayers()
        if layer not in left_out
    }
    target = stage.GetEditTarget().GetLayer().identifier
    return [layers, target, stage.GetLoadRules(), stage.GetPopulationMask(), stage.GetMutedLayers()]


def shown(stage: Usd.Stage, output: Sdf.Layer) -> Usd.Stage:
    """A stage with the output above the root layer of another."""
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.subLayerPaths = [output.identifier, stage.GetRootLayer().identifier]
    layer.timeCodesPerSecond = stage.GetTimeCodesPerSecond()
    return Usd.Stage.Open(layer)


def test_open_anonymous_stage_in_and_its_layer_out_change_nothing_else():
    stage = cloth_stage()
    define_cloth(stage, "/Root/Other")
    layer = Sdf.Layer.CreateAnonymous("edits.usda")
    stage.GetRootLayer().subLayerPaths.insert(0, layer.identifier)
    weaker = Sdf.Layer.CreateAnonymous("assets.usda")
    weaker.TransferContent(stage.GetRootLayer())
    weaker.subLayerPaths.clear()
    stage.GetRootLayer().subLayerPaths.append(weaker.identifier)
    stage.GetRootLayer().rootPrims.clear()
    stage.SetEditTarget(weaker)
    before = state(stage, layer)
    report = simplify(stage, layer, prims=(CLOTH,))
    assert [(prim.path, prim.status, prim.faces_after) for prim in report.prims] == [(CLOTH, "simplified", 51)]
    assert (report.input, report.output) == (stage.GetRootLayer().identifier, layer.identifier)
    assert state(stage, layer) == before
    # The stage shows it at once.
    assert (faces_at(stage, CLOTH), faces_at(stage, "/Root/Other")) == (51, 64)
    assert [str(spec.path) for spec in layer.rootPrims] == ["/Root"]
    check_stage(stage)


def test_layer_that_the_stage_does_not_use_gets_the_edits_at_its_own_rate():
    stage = cloth_stage()
    before = state(stage)
    output = Sdf.Layer.CreateAnonymous("edits.usda")
    output.timeCodesPerSecond = 60
    output.comment = "kept"
    Sdf.CreatePrimInLayer(output, "/Root/Mine").documentation = "kept"
    simplify(stage, output)
    assert state(stage) == before
    assert (output.comment, output.GetPrimAtPath("/Root/Mine").documentation) == ("kept", "kept")
    result = shown(stage, output)
    assert faces_at(result, CLOTH) == 51
    assert UsdGeom.Mesh(result.GetPrimAtPath(CLOTH)).GetPointsAttr().GetTimeSamples() == FRAMES
    check_stage(result)


def test_root_layer_as_output_is_edited_in_place_again_and_again():
    stage = cloth_stage()
    for count in (51, 20):
        report = simplify(stage, stage.GetRootLayer())
        assert (report.prims[0].faces_after, faces_at(stage, CLOTH)) == (count, count)
        check_stage(stage)
    assert UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)).GetPointsAttr().GetTimeSamples() == FRAMES


def test_session_edits_are_read_and_the_session_layer_can_be_the_output():
    stage = cloth_stage()
    root = stage.GetRootLayer().ExportToString()
    with Usd.EditContext(stage, stage.GetSessionLayer()):
        define_cloth(stage, CLOTH, size=6, times=FRAMES)
    with pytest.raises(StageError, match=r"/Root/Cloth.*: the edit would be hidden in .*, as the stronger layer"):
        simplify(stage, stage.GetRootLayer())
    assert stage.GetRootLayer().ExportToString() == root
    report = simplify(stage, stage.GetSessionLayer())
    assert (report.prims[0].faces_before, faces_at(stage, CLOTH)) == (72, report.prims[0].faces_after)
    assert stage.GetRootLayer().ExportToString() == root


def test_variant_that_the_session_selects_is_done():
    stage = cloth_stage()
    cut = stage.GetPrimAtPath("/Root").GetVariantSets().AddVariantSet("cut")
    for name, size in (("long", 8), ("short", 6)):
        cut.AddVariant(name)
        cut.SetVariantSelection(name)
        with cut.GetVariantEditContext():
            define_cloth(stage, "/Root/Flag", size=size)
    with Usd.EditContext(stage, stage.GetSessionLayer()):
        cut.SetVariantSelection("long")
    output = Sdf.Layer.CreateAnonymous(".usda")
    report = simplify(stage, output, prims=("/Root/Flag",))
    assert report.prims[0].faces_before == 128


def test_unsaved_edits_of_a_file_are_done_and_named(tmp_path, flatten):
    stage = cloth_stage(tmp_path / "in.usda")
    text = (tmp_path / "in.usda").read_bytes()
    define_cloth(stage, "/Root/New", size=6)
    report = simplify(stage, tmp_path / "out.usda", flatten=flatten)
    assert [prim.path for prim in report.prims] == [CLOTH, "/Root/New"]
    assert any("in.usda: has changes that are not saved" in problem for problem in report.problems) == (not flatten)
    assert (tmp_path / "in.usda").read_bytes() == text
    assert stage.GetRootLayer().dirty


def test_stage_in_memory_needs_a_flat_file(tmp_path):
    stage = cloth_stage()
    with pytest.raises(OptionError, match="is in memory, and a file cannot be a layer over it; flatten"):
        simplify(stage, tmp_path / "out.usda")
    with pytest.raises(OptionError, match="is in memory"):
        simplify(stage, tmp_path / "out.usda", ratio=None, lods=(0.5,))
    simplify(stage, tmp_path / "out.usda", flatten=True)
    result = Usd.Stage.Open(str(tmp_path / "out.usda"))
    assert (faces_at(result, CLOTH), result.GetTimeCodesPerSecond()) == (51, 30)


@pytest.mark.parametrize("options", [{"flatten": True}, {"ratio": None, "lods": (0.5,)}])
def test_layer_as_output_excludes_what_needs_a_file(options):
    with pytest.raises(OptionError, match="needs a file as output, not the layer"):
        simplify(cloth_stage(), Sdf.Layer.CreateAnonymous(), **options)


def test_layer_of_a_referenced_asset_is_no_output(tmp_path):
    stage = scene_of(tmp_path)
    with pytest.raises(OptionError, match="not as one of its own layers"):
        simplify(stage, Sdf.Layer.Find(str(tmp_path / "tile.usda")))
    locked = Sdf.Layer.CreateAnonymous()
    locked.SetPermissionToEdit(False)
    with pytest.raises(OptionError, match="must not be edited"):
        simplify(stage, locked)


def test_population_mask_and_load_rules_say_what_is_done(tmp_path):
    tile_file(tmp_path / "tile.usda")
    stage = Usd.Stage.CreateNew(str(tmp_path / "in.usda"))
    for name in ("Loaded", "Unloaded", "Masked"):
        stage.DefinePrim(f"/{name}").GetPayloads().AddPayload("./tile.usda")
    stage.Save()
    mask = Usd.StagePopulationMask(["/Loaded", "/Unloaded"])
    opened = Usd.Stage.OpenMasked(str(tmp_path / "in.usda"), mask, Usd.Stage.LoadNone)
    opened.Load("/Loaded")
    before = state(opened)
    output = Sdf.Layer.CreateAnonymous(".usda")
    report = simplify(opened, output)
    assert [prim.path for prim in report.prims] == ["/Loaded/Cloth"]
    assert state(opened) == before


def test_instances_of_an_open_stage_stay_closed_on_it(tmp_path):
    stage = scene_of(tmp_path)
    before = state(stage)
    output = Sdf.Layer.CreateAnonymous(".usda")
    simplify(stage, output)
    assert state(stage) == before
    assert stage.GetPrimAtPath("/Set/First").IsInstance()
    result = shown(stage, output)
    assert faces_at(result, "/Set/Second/Cloth") == 51
    assert len(result.GetPrototypes()) == 1
    check_stage(result)


def test_edits_go_through_the_offset_of_a_sublayer(tmp_path):
    cloth_stage(tmp_path / "cloth.usda")
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.timeCodesPerSecond = 30
    layer.subLayerPaths.append(str(tmp_path / "cloth.usda"))
    layer.subLayerOffsets[0] = Sdf.LayerOffset(10, 2)
    stage = Usd.Stage.Open(layer)
    sublayer = Sdf.Layer.Find(str(tmp_path / "cloth.usda"))
    points = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)).GetPointsAttr()
    times = points.GetTimeSamples()
    simplify(stage, sublayer)
    assert (faces_at(stage, CLOTH), points.GetTimeSamples()) == (51, times)
    assert sublayer.ListTimeSamplesForPath(points.GetPath()) == FRAMES


@pytest.fixture
def search_path(tmp_path: Path) -> Any:
    """A folder that the resolver searches, and nothing else does."""
    folder = tmp_path / "library"
    folder.mkdir()
    Ar.DefaultResolver.SetDefaultSearchPath([str(folder)])
    (folder / "probe.usda").write_text("#usda 1.0\n")
    if not Ar.GetResolver().Resolve("probe.usda"):
        pytest.skip("the resolver of this USD keeps the search path that it began with")
    yield folder
    Ar.DefaultResolver.SetDefaultSearchPath([])


def test_input_is_found_on_the_search_path_of_the_resolver(search_path, tmp_path, flatten):
    tile_file(search_path / "searched_tile.usda")
    report = simplify("searched_tile.usda", tmp_path / "out.usda", flatten=flatten)
    assert (report.input, report.prims[0].status) == ("searched_tile.usda", "simplified")
    assert faces_at(Usd.Stage.Open(str(tmp_path / "out.usda")), CLOTH) == 51


def test_input_on_the_search_path_is_never_overwritten(search_path):
    tile_file(search_path / "searched_own.usda")
    text = (search_path / "searched_own.usda").read_bytes()
    with pytest.raises(OptionError, match="never overwritten"):
        simplify("searched_own.usda", search_path / "searched_own.usda")
    assert (search_path / "searched_own.usda").read_bytes() == text


def test_references_are_found_through_the_resolver_context_of_a_stage(tmp_path):
    (tmp_path / "library").mkdir()
    tile_file(tmp_path / "library" / "context_tile.usda")
    layer = Sdf.Layer.CreateAnonymous(".usda")
    Sdf.CreatePrimInLayer(layer, "/Prop").specifier = Sdf.SpecifierDef
    layer.GetPrimAtPath("/Prop").referenceList.Prepend(Sdf.Reference("context_tile.usda"))
    stage = Usd.Stage.Open(layer, Ar.ResolverContext(Ar.DefaultResolverContext([str(tmp_path / "library")])))
    assert stage.GetPrimAtPath("/Prop/Cloth")
    report = simplify(stage, stage.GetRootLayer())
    assert (report.prims[0].status, faces_at(stage, "/Prop/Cloth")) == ("simplified", 51)


def test_input_within_a_package_is_found(tmp_path, flatten):
    tile_file(tmp_path / "tile.usdc")
    tile_file(tmp_path / "first.usdc")
    # It moved from one module to the other.
    writer = getattr(Sdf, "ZipFileWriter", None) or Usd.ZipFileWriter
    with writer.CreateNew(str(tmp_path / "in.usdz")) as package:
        for name in ("first.usdc", "tile.usdc"):
            package.AddFile(str(tmp_path / name), name)
    report = simplify(f"{tmp_path}/in.usdz[tile.usdc]", tmp_path / "out.usda", flatten=flatten)
    assert report.prims[0].status == "simplified"
    assert faces_at(Usd.Stage.Open(str(tmp_path / "out.usda")), CLOTH) == 51
    with pytest.raises(StageError, match=r"in\.usdz\[none\.usdc\]: no such file"):
        simplify(f"{tmp_path}/in.usdz[none.usdc]", tmp_path / "out.usda")


def test_layer_in_memory_is_an_input_by_its_identifier(tmp_path):
    stage = cloth_stage()
    report = simplify(stage.GetRootLayer().identifier, tmp_path / "out.usda", flatten=True)
    assert report.prims[0].status == "simplified"
    with pytest.raises(StageError, match="no such file"):
        simplify("anon:0x0:none.usda", tmp_path / "out.usda", flatten=True)
