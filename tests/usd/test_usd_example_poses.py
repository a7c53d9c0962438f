"""Example poses from another file, and a limit on the joints that move a point."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from tests.support.usd_stages import FRAMES, cloth_stage, skinned_stage
from warpqem.errors import OptionError
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.write.stage_report import StageReport

BODY = "/Char/Body"


def simplified(folder: Path, name: str = "out", **options: object) -> tuple[Usd.Stage, StageReport]:
    output = folder / f"{name}.usda"
    report = simplify_stage(folder / "in.usda", output, SimplifyOptions(**{"ratio": 0.3, "device": "cpu", **options}))
    return Usd.Stage.Open(str(output)) if report.output else None, report


def rest_points(stage: Usd.Stage) -> np.ndarray:
    return np.array(UsdGeom.Mesh(stage.GetPrimAtPath(BODY)).GetPointsAttr().Get())


def test_example_poses_take_the_place_of_the_animation_of_a_skin(tmp_path, clip):
    own, _ = simplified(tmp_path, "own")
    stage, report = simplified(tmp_path, poses=clip)
    [prim] = report.prims
    assert prim.frames == 5
    assert rest_points(stage).shape == rest_points(own).shape
    assert not np.array_equal(rest_points(stage), rest_points(own))


def test_output_keeps_the_animation_of_the_input(tmp_path, clip):
    before = Usd.Stage.Open(str(tmp_path / "in.usda"))
    stage, _ = simplified(tmp_path, poses=clip)
    rotations = [item.GetAttributeAtPath("/Char/Rig/Anim.rotations") for item in (before, stage)]
    assert rotations[1].GetTimeSamples() == rotations[0].GetTimeSamples() == FRAMES
    assert not rotations[1].GetCustomDataByKey("clip")


def test_example_poses_of_point_samples_come_beside_the_own(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    other = cloth_stage(tmp_path / "other.usda")
    points = UsdGeom.Mesh(other.GetPrimAtPath("/Root/Cloth")).GetPointsAttr()
    points.Set(np.array(points.Get(FRAMES[0])) * [1, 1, -3], FRAMES[0])
    other.Save()
    stage, report = simplified(tmp_path, poses=tmp_path / "other.usda", quality="fast")
    assert report.prims[0].frames == len(FRAMES)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth"))
    assert mesh.GetPointsAttr().GetTimeSamples() == FRAMES
    # The poses are those of the input, not the examples turned upside down.
    source = Usd.Stage.Open(str(tmp_path / "in.usda"))
    before = UsdGeom.Mesh(source.GetPrimAtPath("/Root/Cloth")).GetPointsAttr()
    for time in FRAMES:
        had, has = (np.array(attribute.Get(time)) for attribute in (before, mesh.GetPointsAttr()))
        np.testing.assert_allclose(has.mean(axis=0), had.mean(axis=0), atol=0.3)


def test_file_that_moves_no_mesh_is_an_error(tmp_path):
    skinned_stage(tmp_path / "in.usda")
    cloth_stage(tmp_path / "other.usda")
    _, report = simplified(tmp_path, poses=tmp_path / "other.usda")
    [prim] = report.failed
    assert "no poses of /Char/Body" in prim.message
    assert "/Char/Rig/Anim" in prim.message


def test_examples_with_other_faces_are_an_error(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    cloth_stage(tmp_path / "other.usda", size=5)
    _, report = simplified(tmp_path, poses=tmp_path / "other.usda")
    [prim] = report.failed
    assert "/Root/Cloth has other points or faces" in prim.message


@pytest.mark.parametrize("limit", [1, 2])
def test_points_have_no_more_influences_than_asked_for(tmp_path, limit):
    skinned_stage(tmp_path / "in.usda")
    stage, _ = simplified(tmp_path, influences=limit)
    api = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath(BODY))
    joints, weights = (api.GetPrimvar(f"skel:{name}") for name in ("jointIndices", "jointWeights"))
    assert joints.GetElementSize() == weights.GetElementSize() == limit
    np.testing.assert_allclose(np.array(weights.Get()).reshape(-1, limit).sum(axis=1), 1, atol=1e-6)


def test_influences_below_one_are_refused():
    with pytest.raises(OptionError, match="influences must be a whole number at least 1, got 0"):
        SimplifyOptions(ratio=0.5, influences=0)


def test_input_may_be_its_own_example(tmp_path):
    skinned_stage(tmp_path / "in.usda")
    own, _ = simplified(tmp_path, "own")
    stage, _ = simplified(tmp_path, poses=tmp_path / "in.usda")
    np.testing.assert_array_equal(rest_points(stage), rest_points(own))
