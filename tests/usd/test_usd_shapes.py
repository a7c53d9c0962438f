"""Fewer blend shapes for the meshes of a stage."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdSkel

from tests.support.cli import run
from tests.support.usd_rig import ANIMATION, FRAMES, TUBE, rms, shaped_rig
from warpqem.errors import OptionError
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.write.stage_report import PrimReport, StageReport


def simplified(folder: Path, **options: object) -> tuple[Usd.Stage, PrimReport]:
    report = reported(folder, **options)
    # Flattened, because the next run writes the same file.
    return Usd.Stage.Open(Usd.Stage.Open(str(folder / "out.usda")).Flatten()), report.prims[0]


def reported(folder: Path, **options: object) -> StageReport:
    chosen = SimplifyOptions(**{"ratio": 0.2, "device": "cpu", **options})
    report = simplify_stage(folder / "in.usda", folder / "out.usda", chosen)
    assert {prim.status for prim in report.prims} == {"simplified"}
    return report


def weights(stage: Usd.Stage) -> np.ndarray:
    attribute = UsdSkel.Animation(stage.GetPrimAtPath(ANIMATION)).GetBlendShapeWeightsAttr()
    return np.array([attribute.Get(frame) for frame in FRAMES])


def test_shape_of_nothing_and_a_sum_of_others_go(tmp_path):
    shaped_rig(tmp_path / "in.usda")
    stage, report = simplified(tmp_path, shapes=2)
    assert report.shapes.removed == ["nothing", "both"]
    assert (report.shapes.before, report.shapes.after) == (4, 2)
    assert report.shapes.merged["both"] == pytest.approx({"left": 1.0, "right": 1.0}, abs=0.02)
    binding = UsdSkel.BindingAPI(stage.GetPrimAtPath(TUBE))
    assert list(binding.GetBlendShapesAttr().Get()) == ["left", "right"]
    assert [path.name for path in binding.GetBlendShapeTargetsRel().GetTargets()] == ["left", "right"]
    assert not stage.GetPrimAtPath(f"{TUBE}/both")


def test_animation_goes_on_with_corrected_weights(tmp_path):
    source = shaped_rig(tmp_path / "in.usda")
    stage, report = simplified(tmp_path, shapes=2)
    before, after = weights(source), weights(stage)
    parts = report.shapes.merged["both"]
    np.testing.assert_allclose(after[:, 0], before[:, 0] + parts["left"] * before[:, 2], atol=1e-5)
    np.testing.assert_array_equal(after[:, 2:], before[:, 2:])
    assert (after <= 1).all()
    plain, _ = simplified(tmp_path)
    assert rms(source, stage) < 1.05 * rms(source, plain)
    assert rms(source, stage) == pytest.approx(report.measured["rms"], rel=0.15)


def test_limit_on_the_error_takes_what_nothing_shows(tmp_path):
    shaped_rig(tmp_path / "in.usda")
    _, report = simplified(tmp_path, shape_error=1e-4)
    assert report.shapes.removed == ["nothing"]
    assert report.shapes.random_error <= 1e-4


def test_weights_that_another_mesh_uses_stay(tmp_path):
    source = shaped_rig(tmp_path / "in.usda", meshes=2)
    report = reported(tmp_path, shapes=2)
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    np.testing.assert_array_equal(weights(stage), weights(source))
    assert all(prim.shapes.merged == {} for prim in report.prims)


def test_each_level_has_its_own_number_of_shapes_and_weights(tmp_path):
    source = shaped_rig(tmp_path / "in.usda")
    report = reported(tmp_path, ratio=None, lods=(0.4, 0.2), shapes=(3, 2))
    assert [prim.shapes.after for prim in report.prims] == [3, 2]
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    variants = stage.GetDefaultPrim().GetVariantSet("LOD")
    np.testing.assert_array_equal(weights(stage), weights(source))
    variants.SetVariantSelection("LOD2")
    assert not np.array_equal(weights(stage), weights(source))
    assert list(UsdSkel.BindingAPI(stage.GetPrimAtPath(TUBE)).GetBlendShapesAttr().Get()) == ["left", "right"]


def test_joints_and_shapes_go_together(tmp_path):
    source = shaped_rig(tmp_path / "in.usda")
    stage, report = simplified(tmp_path, shapes=2, joints=4)
    assert (report.shapes.after, report.joints.after) == (2, 4)
    plain, _ = simplified(tmp_path)
    assert rms(source, stage) < 1.1 * rms(source, plain)


def test_table_names_the_shapes_that_went(tmp_path):
    shaped_rig(tmp_path / "in.usda")
    files = (str(tmp_path / "in.usda"), "-o", str(tmp_path / "out.usda"))
    shown = run("simplify", *files, "--ratio", "0.2", "--shapes", "2", "--device", "cpu")
    assert shown.exit_code == 0
    assert "2 of 4" in shown.output
    assert "without the blend shapes nothing, both; 1 of them go on in others" in " ".join(shown.output.split())


def test_baked_shapes_cannot_go():
    with pytest.raises(OptionError, match="shapes and shape_error exclude bake"):
        SimplifyOptions(ratio=0.2, shapes=2, bake=True)


def test_shapes_without_an_animation_are_chosen_by_random_weights(tmp_path):
    stage = shaped_rig(tmp_path / "in.usda")
    stage.RemovePrim(ANIMATION)
    stage.Save()
    _, report = simplified(tmp_path, shapes=2)
    assert report.shapes.removed == ["nothing", "both"]
    assert report.shapes.used_error == 0
