"""Variants and levels of detail that commands look at."""

from __future__ import annotations

import importlib.util
import json

import pytest
from pxr import Sdf, Usd, UsdGeom, UsdShade
from typer.testing import CliRunner

from tests.support.usd_stages import cloth_stage
from warpqem.cli.app import app
from warpqem.errors import OptionError
from warpqem.usd import CompareOptions, SimplifyOptions, compare_stages, inspect_stage, simplify_stage
from warpqem.usd.commands.render import RenderOptions, render_sheet
from warpqem.usd.commands.report_page import stage_report
from warpqem.usd.read.inspect import inspect_with_problems
from warpqem.usd.read.variants import VariantChoice, select_variants

CLOTH = "/Root/Cloth"
LEVELS = (0.5, 0.25)
FORMS = [False, pytest.param(True, marks=pytest.mark.skipif(
    importlib.util.find_spec("pxr.UsdLod") is None, reason="UsdLod is part of USD from 26.08 on"))]  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A cloth, and the same with levels as variants."""
    place = tmp_path_factory.mktemp("levels")
    cloth_stage(place / "in.usda", times=[1.0, 2.0, 4.0])
    simplify_stage(place / "in.usda", place / "lods.usda", SimplifyOptions(lods=LEVELS, device="cpu"))
    return place


def two_sets(path) -> Usd.Stage:
    """A stage on which two prims have the variant set `shape`, one of them with a set inside a variant."""
    stage = Usd.Stage.CreateNew(str(path))
    for name in ("A", "B"):
        prim = stage.DefinePrim(f"/{name}", "Xform")
        variants = prim.GetVariantSets().AddVariantSet("shape")
        for variant in ("flat", "round"):
            variants.AddVariant(variant)
            variants.SetVariantSelection(variant)
            with variants.GetVariantEditContext():
                UsdGeom.Xform.Define(stage, f"/{name}/{variant}")
                if variant == "round":
                    inner = prim.GetVariantSets().AddVariantSet("size")
                    inner.AddVariant("large")
        variants.SetVariantSelection("flat")
    stage.GetRootLayer().Save()
    return stage


@pytest.mark.parametrize(
    ("text", "choice"),
    [
        ("LOD=LOD1", VariantChoice("LOD", "LOD1")),
        ("/Root/Hero{look=red-2}", VariantChoice("look", "red-2", Sdf.Path("/Root/Hero"))),
    ],
)
def test_choice_is_read_as_it_is_written(text, choice):
    assert VariantChoice.parse(text) == choice
    assert str(choice) == text


@pytest.mark.parametrize("text", ["", "LOD", "=LOD1", "LOD=", "Root{LOD=LOD1}", "/Root{LOD}", "/Body 1{LOD=LOD1}"])
def test_what_is_no_choice_is_refused(text):
    with pytest.raises(OptionError, match="expected SET=NAME"):
        VariantChoice.parse(text)


def test_set_of_several_prims_needs_the_prim(tmp_path):
    stage = two_sets(tmp_path / "in.usda")
    with pytest.raises(OptionError, match=r"2 prims have this set.*'/A\{shape=round\}', '/B\{shape=round\}'"):
        select_variants([stage], ["shape=round"])
    [[choice]] = select_variants([stage], ["/B{shape=round}"])
    assert choice.prim == Sdf.Path("/B")
    assert stage.GetPrimAtPath("/B/round")
    assert stage.GetPrimAtPath("/A/flat")
    assert not stage.GetRootLayer().dirty


def test_set_within_a_variant_can_be_chosen_after_it(tmp_path):
    stage = two_sets(tmp_path / "in.usda")
    with pytest.raises(OptionError, match="no prim has a variant set 'size'; variant sets are shape"):
        select_variants([stage], ["size=large"])
    select_variants([stage], ["/A{shape=round}", "size=large"])
    assert stage.GetPrimAtPath("/A").GetVariantSet("size").GetVariantSelection() == "large"


def test_unknown_variant_is_named_with_those_there_are(folder):
    with pytest.raises(OptionError, match="has the variants LOD0, LOD1, LOD2"):
        inspect_stage(folder / "lods.usda", variants=["LOD=LOD3"])


def test_missing_files_are_those_of_the_variant_looked_at(tmp_path):
    stage = Usd.Stage.CreateNew(str(tmp_path / "in.usda"))
    prim = stage.DefinePrim("/Root", "Xform")
    variants = prim.GetVariantSets().AddVariantSet("look")
    for variant in ("plain", "painted"):
        variants.AddVariant(variant)
        variants.SetVariantSelection(variant)
        with variants.GetVariantEditContext():
            shader = UsdShade.Shader.Define(stage, "/Root/Shader")
            shader.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(f"{variant}.png")
    stage.Save()
    for variant in ("plain", "painted"):
        _, problems = inspect_with_problems(tmp_path / "in.usda", variants=[f"look={variant}"])
        assert len(problems) == 1
        assert f"{variant}.png" in problems[0]


@pytest.mark.parametrize(("level", "count"), [("LOD0", 128), ("LOD1", 64), ("LOD2", 32)])
def test_level_is_described(folder, level, count):
    [info] = inspect_stage(folder / "lods.usda", variants=[f"LOD={level}"])
    assert info.triangles == count


def test_level_is_compared_with_the_input(folder):
    options = CompareOptions(variants=("LOD=LOD2",), samples=500, device="cpu")
    [pair] = compare_stages(folder / "in.usda", folder / "lods.usda", options)
    assert pair.comparison.test_topology.faces == 32


def test_heat_map_shows_the_variant_that_was_compared(folder, tmp_path):
    heatmap = tmp_path / "heat.usda"
    options = CompareOptions(variants=("LOD=LOD2",), samples=500, device="cpu", heatmap=str(heatmap))
    compare_stages(folder / "in.usda", folder / "lods.usda", options)
    stage = Usd.Stage.Open(str(heatmap))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH))
    assert len(mesh.GetFaceVertexCountsAttr().Get()) == 32
    assert len(mesh.GetDisplayColorPrimvar().Get(1.0)) == len(mesh.GetPointsAttr().Get(1.0))


@pytest.mark.parametrize("usd_lod", FORMS)
def test_all_levels_are_compared_one_after_another(folder, tmp_path, usd_lod):
    simplify_stage(
        folder / "in.usda", tmp_path / "lods.usda", SimplifyOptions(lods=LEVELS, usd_lod=usd_lod, device="cpu")
    )
    options = CompareOptions(all_lods=True, samples=500, device="cpu")
    pairs = compare_stages(folder / "in.usda", tmp_path / "lods.usda", options)
    assert [(pair.level, pair.path, pair.message) for pair in pairs] == [("LOD1", CLOTH, None), ("LOD2", CLOTH, None)]
    assert [pair.comparison.test_topology.faces for pair in pairs] == [64, 32]
    assert pairs[0].comparison.rms < pairs[1].comparison.rms


def test_all_levels_of_a_file_without_any_are_refused(folder):
    with pytest.raises(OptionError, match=r"in\.usda: has no levels of detail"):
        compare_stages(folder / "in.usda", folder / "in.usda", CompareOptions(all_lods=True, device="cpu"))


def test_command_writes_the_level_of_each_row(folder, tmp_path):
    arguments = ["compare", folder / "in.usda", folder / "lods.usda", "--all-lods", "--samples", "500"]
    more = ["--device", "cpu", "--json", tmp_path / "pairs.json", "--report", tmp_path / "page.html"]
    result = CliRunner().invoke(app, list(map(str, [*arguments, *more])))
    assert result.exit_code == 0, result.output
    assert [pair["level"] for pair in json.loads((tmp_path / "pairs.json").read_text())["prims"]] == ["LOD1", "LOD2"]
    assert "LOD2" in result.stdout
    assert (tmp_path / "page.html").stat().st_size > 1000


def test_level_is_drawn(folder, tmp_path):
    for level in ("LOD0", "LOD2"):
        options = RenderOptions(pictures=1, size=(80, 60), lines=True, device="cpu", variants=(f"LOD={level}",))
        render_sheet(folder / "lods.usda", tmp_path / f"{level}.png", options, folder / "in.usda")
    assert (tmp_path / "LOD0.png").read_bytes() != (tmp_path / "LOD2.png").read_bytes()


def test_level_is_shown_beside_the_input(folder):
    report = stage_report(str(folder / "in.usda"), str(folder / "lods.usda"), variants=("LOD=LOD1",))
    assert [len(level.faces) for level in report.levels] == [64]
    assert len(report.faces) == 128


@pytest.mark.parametrize(
    ("output", "options", "flat"),
    [
        ("o.usda", {"flatten": True}, True),
        ("o.usdz", {}, True),
        ("o.usda", {}, False),
        ("o.usdz", {"ratio": None, "lods": (0.5,)}, False),
    ],
)
def test_flat_file_says_which_variants_it_has(tmp_path, output, options, flat):
    stage = cloth_stage(tmp_path / "in.usda")
    variants = stage.GetPrimAtPath("/Root").GetVariantSets().AddVariantSet("look")
    for name in ("red", "blue"):
        variants.AddVariant(name)
    variants.SetVariantSelection("red")
    stage.Save()
    chosen = SimplifyOptions(**{"ratio": 0.4, "device": "cpu", **options})
    report = simplify_stage(tmp_path / "in.usda", tmp_path / output, chosen)
    text = "a flat file has no variant sets; of these it has what is selected: /Root{look=red}"
    assert (text in report.notes) == flat
