"""Every form of an output shows its meshes where the input shows its own, whoever defines what instances share."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from tests.support.instance_kinds import INSTANCES, instance
from tests.support.usd_stages import cloth_stage
from warpqem.errors import OptionError
from warpqem.usd import CompareOptions, SimplifyOptions, color_features, compare_stages, simplify_stage
from warpqem.usd.commands.compare import PairReport
from warpqem.usd.commands.render import RenderOptions, render_sheet
from warpqem.usd.read.world import WorldMeshes, limit_places

LEVELS = {"lods": (0.7, 0.5)}
# Name of the file, options, and whether it holds levels.
FORMS = {
    "layer": ("out.usda", {}),
    "flat": ("out.usdc", {"flatten": True}),
    "package": ("out.usdz", {}),
    "bake": ("out.usda", {"bake": True, "flatten": True}),
    "levels": ("out.usda", LEVELS),
    "level_files": ("out.usda", LEVELS | {"lod_files": True, "flatten": True}),
} | ({} if importlib.util.find_spec("pxr.UsdLod") is None else {"usd_lod": ("out.usda", LEVELS | {"usd_lod": True})})


def simplified(tmp_path: Path, kind: str, form: str) -> list[str]:
    """The files that came of a stage, in a folder of their own."""
    name, options = FORMS[form]
    INSTANCES[kind](tmp_path / "in.usda")
    (tmp_path / "out").mkdir()
    ratio = {} if "lods" in options else {"ratio": 0.7}
    chosen = SimplifyOptions(device="cpu", measure=False, **ratio, **options)
    report = simplify_stage(tmp_path / "in.usda", tmp_path / "out" / name, chosen)
    assert not report.failed
    return report.outputs


def compared(tmp_path: Path, output: str, **options: object) -> list[PairReport]:
    return compare_stages(tmp_path / "in.usda", output, CompareOptions(samples=20, device="cpu", **options))


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("kind", INSTANCES)
def test_every_output_can_be_compared_with_its_input(kind, form, tmp_path):
    for output in simplified(tmp_path, kind, form):
        for options in ({}, {"all_lods": True}) if form in ("levels", "usd_lod") else ({},):
            pairs = compared(tmp_path, output, **options)
            assert [pair.message for pair in pairs if pair.message] == []
            # Poses of another place, or of a skeleton that is not found, are far off.
            assert max(pair.comparison.rms for pair in pairs) < 6.0


@pytest.mark.parametrize("form", [form for form in ("flat", "usd_lod") if form in FORMS])
@pytest.mark.parametrize("kind", INSTANCES)
def test_input_and_output_are_drawn_at_the_same_places(kind, form, tmp_path):
    [output] = simplified(tmp_path, kind, form)
    sheet = RenderOptions(pictures=1, size=(32, 24), device="cpu", heatmap=True)
    scale = render_sheet(output, tmp_path / "sheet.png", sheet, tmp_path / "in.usda")
    assert scale < 6.0


def test_all_instances_are_drawn(tmp_path):
    INSTANCES["in_each_other"](tmp_path / "in.usda")
    points, faces = WorldMeshes(tmp_path / "in.usda").read([1.0])
    # Two groups of two, and one alone.
    assert len(faces) == 5 * 128
    assert np.ptp(points[0, :, 0]) == pytest.approx(12.0 + 3.0 + 8.0)


def test_too_many_instances_are_drawn_once_in_both_files(tmp_path, monkeypatch):
    [output] = simplified(tmp_path, "of_another_file", "flat")
    drawn = [WorldMeshes(path) for path in (tmp_path / "in.usda", output)]
    monkeypatch.setattr("warpqem.usd.read.world.MAX_POINTS", 10)
    assert limit_places(drawn)
    (before, _), (after, _) = (item.read([1.0]) for item in drawn)
    np.testing.assert_allclose(before[0].mean(axis=0), after[0].mean(axis=0), atol=0.3)


def test_instance_that_one_file_lacks_is_named(tmp_path):
    INSTANCES["of_another_file"](tmp_path / "in.usda")
    stage = Usd.Stage.CreateNew(str(tmp_path / "less.usda"))
    UsdGeom.Xform.Define(stage, "/Set")
    instance(stage, "/Set/First", "./tile.usda", "", 5.0)
    stage.Save()
    found = {pair.path: pair.message for pair in compared(tmp_path, str(tmp_path / "less.usda"))}
    assert found["/Set/First/Cloth"] is None
    assert found["/Set/Second/Cloth"] == f"/Set/Second/Cloth: no such mesh in {tmp_path / 'less.usda'}"


@pytest.mark.parametrize("form", ["layer", "flat"])
@pytest.mark.parametrize("kind", INSTANCES)
def test_heat_map_shows_on_every_instance(kind, form, tmp_path):
    [output] = simplified(tmp_path, kind, form)
    compared(tmp_path, output, heatmap=str(tmp_path / "heat.usda"))
    stage = Usd.Stage.Open(str(tmp_path / "heat.usda"))
    for path in find_places(tmp_path / "in.usda"):
        mesh = UsdGeom.Mesh(stage.GetPrimAtPath(path))
        colors = mesh.GetDisplayColorPrimvar().Get(Usd.TimeCode.EarliestTime())
        assert colors is not None, path
        assert len(colors) == len(mesh.GetPointsAttr().Get(Usd.TimeCode.EarliestTime()))


def find_places(path: Path) -> list[str]:
    stage = Usd.Stage.Open(str(path))
    prims = Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies())
    return [str(prim.GetPath()) for prim in prims if prim.IsA(UsdGeom.Mesh)]


def test_features_show_on_instances_of_another_file(tmp_path):
    INSTANCES["of_another_file"](tmp_path / "in.usda")
    color_features(tmp_path / "in.usda", tmp_path / "out.usda", device="cpu")
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    for name in ("First", "Second"):
        assert UsdGeom.Mesh(stage.GetPrimAtPath(f"/Set/{name}/Cloth")).GetDisplayColorPrimvar().Get() is not None


def test_skin_of_instances_of_a_flat_file_is_found(tmp_path):
    # The prototype of a flat file has not the type of its instances, SkelRoot.
    [output] = simplified(tmp_path, "skinned", "flat")
    again = simplify_stage(output, tmp_path / "again.usda", SimplifyOptions(ratio=0.7, device="cpu"))
    [prim] = again.prims
    assert (prim.path, prim.skin, prim.dropped) == ("/Set/A/Body", "fitted", [])


@pytest.mark.skipif("usd_lod" not in FORMS, reason="this USD has no UsdLod")
def test_heat_map_over_levels_that_are_prims_is_refused(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    options = SimplifyOptions(device="cpu", measure=False, usd_lod=True, **LEVELS)
    simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options)
    with pytest.raises(OptionError, match="levels as prims"):
        compared(tmp_path, str(tmp_path / "out.usda"), heatmap=str(tmp_path / "heat.usda"))
