"""Limits on the distance of meshes with fewer influences and blend shapes: they hold, and what had to stay is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdSkel

from tests.support.usd_rig import ANIMATION, FRAMES, TUBE, baked, shaped_rig
from warpqem.measure import compare
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.write.stage_report import PrimReport


def simplified(folder: Path, **options: object) -> tuple[Usd.Stage, PrimReport]:
    report = simplify_stage(folder / "in.usda", folder / "out.usda", SimplifyOptions(**{"device": "cpu", **options}))
    assert report.prims[0].problems == []
    return Usd.Stage.Open(str(folder / "out.usda")), report.prims[0]


def largest_distance(first: Usd.Stage, second: Usd.Stage) -> float:
    """Of what UsdSkel bakes, over all frames and both ways, in %."""
    return compare(*baked(first), *baked(second), samples=500, device="cpu").hausdorff


def unskinned(stage: Usd.Stage) -> None:
    """Take the joints off the tube, so that blend shapes alone move it."""
    prim = stage.GetPrimAtPath(TUBE)
    for name in ("primvars:skel:jointIndices", "primvars:skel:jointWeights"):
        prim.RemoveProperty(name)
    stage.Save()


def moved_as_a_whole(stage: Usd.Stage) -> None:
    """Let one joint move all of the tube; UsdSkel bakes its rotation into the transform of the mesh."""
    unskinned(stage)
    binding = UsdSkel.BindingAPI(stage.GetPrimAtPath(TUBE))
    binding.CreateJointIndicesPrimvar(True, 1).Set([2])
    binding.CreateJointWeightsPrimvar(True, 1).Set([1.0])
    stage.Save()


def test_as_many_shapes_stay_as_a_limit_asks_for(tmp_path):
    source = shaped_rig(tmp_path / "in.usda")
    stage, report = simplified(tmp_path, max_error=1.0, shapes=1)
    assert largest_distance(source, stage) <= 1.0
    # The sum of two and the one of nothing do without; one of the two would leave what it moves.
    assert report.shapes.after == 2
    assert f"{TUBE}: 2 of 4 blend shapes stay, as max_error 1 % does not hold with fewer; asked for: 1" in report.notes
    assert list(UsdSkel.BindingAPI(stage.GetPrimAtPath(TUBE)).GetBlendShapesAttr().Get()) == ["left", "right"]


def test_shapes_that_a_limit_allows_go_with_corrected_weights(tmp_path):
    source = shaped_rig(tmp_path / "in.usda")
    stage, report = simplified(tmp_path, max_error=1.0, shapes=2)
    assert (report.shapes.after, report.notes) == (2, [])
    assert largest_distance(source, stage) <= 1.0
    first, second = (
        np.array(UsdSkel.Animation(each.GetPrimAtPath(ANIMATION)).GetBlendShapeWeightsAttr().Get(FRAMES[3]))
        for each in (source, stage)
    )
    assert (second[:2] > first[:2] + 0.5 * first[2]).all()


@pytest.mark.parametrize("moved", [unskinned, moved_as_a_whole])
def test_a_limit_holds_for_fewer_shapes_of_a_mesh_without_joints_of_its_points(tmp_path, moved):
    source = shaped_rig(tmp_path / "in.usda")
    moved(source)
    stage, report = simplified(tmp_path, max_error=0.5, shape_error=30.0)
    assert report.measured["hausdorff"] <= 0.5
    # What UsdSkel bakes is not turned, and has a bounding box of another size.
    assert largest_distance(source, stage) <= 0.55
    assert report.shapes.after == 2
    assert any(
        "blend shapes stay, as max_error 0.5 %" in n and "asked for: shape_error 30 %" in n for n in report.notes
    )
    assert not UsdSkel.BindingAPI(stage.GetPrimAtPath(TUBE)).GetJointsAttr().HasAuthoredValue()


def test_as_many_influences_stay_as_a_limit_asks_for(tmp_path):
    source = shaped_rig(tmp_path / "in.usda")
    stage, report = simplified(tmp_path, max_error=1.0, influences=1)
    size = UsdSkel.BindingAPI(stage.GetPrimAtPath(TUBE)).GetJointIndicesPrimvar().GetElementSize()
    assert size > 1
    text = f"{TUBE}: up to {size} joints move a point, as max_error 1 % does not hold with fewer; asked for: 1"
    assert text in report.notes
    assert largest_distance(source, stage) <= 1.0


def test_influences_that_a_limit_allows_go(tmp_path):
    source = shaped_rig(tmp_path / "in.usda")
    stage, report = simplified(tmp_path, max_error=30.0, influences=1)
    assert UsdSkel.BindingAPI(stage.GetPrimAtPath(TUBE)).GetJointIndicesPrimvar().GetElementSize() == 1
    assert report.notes == []
    assert largest_distance(source, stage) <= 30.0


def test_influences_joints_and_shapes_go_as_far_as_a_limit_leaves_them(tmp_path):
    source = shaped_rig(tmp_path / "in.usda")
    stage, report = simplified(tmp_path, max_error=2.0, influences=1, joints=2, shapes=1)
    assert largest_distance(source, stage) <= 2.0
    assert report.joints.after < 5
    assert report.shapes.after < 4
    assert sum("max_error 2 % does not hold with fewer" in note for note in report.notes) == 3


def test_interpolated_influences_hold_a_limit_too(tmp_path):
    source = shaped_rig(tmp_path / "in.usda")
    stage, report = simplified(tmp_path, max_error=1.0, influences=1, skin_fit=False)
    assert report.skin == "interpolated: as asked for"
    assert UsdSkel.BindingAPI(stage.GetPrimAtPath(TUBE)).GetJointIndicesPrimvar().GetElementSize() > 1
    assert largest_distance(source, stage) <= 1.0


def test_names_of_shapes_without_targets_are_said_to_keep_all(tmp_path):
    stage = shaped_rig(tmp_path / "in.usda")
    binding = UsdSkel.BindingAPI(stage.GetPrimAtPath(TUBE))
    binding.GetBlendShapesAttr().Set(["left", "right", "both"])
    stage.Save()
    _, report = simplified(tmp_path, ratio=0.2, shapes=1)
    assert report.shapes is None
    text = "all blend shapes stay, as skel:blendShapes has 3 names and skel:blendShapeTargets 4 targets"
    assert report.notes == [f"{TUBE}: {text}"]
