"""A mesh that keeps all its faces still gets what the options ask of its skin, shapes and normals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pxr import Usd, UsdGeom, UsdSkel

from tests.support.usd_rig import TUBE, rig, shaped_rig
from tests.support.usd_stages import cloth_stage
from warpqem.arguments.distance_limit import DistanceLimit
from warpqem.errors import OptionError
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.commands.core_calls import part_of_limit


def simplified(folder, **options):
    options = {"ratio": 1.0, "device": "cpu", **options}
    report = simplify_stage(folder / "in.usda", folder / "out.usda", SimplifyOptions(**options))
    return report.prims[0], Usd.Stage.Open(str(folder / "out.usda"))


def binding(stage):
    return UsdSkel.BindingAPI(stage.GetPrimAtPath(TUBE))


@pytest.mark.parametrize("goal", [{"ratio": 1.0}, {"ratio": None, "faces": 5000}, {"ratio": 1.0, "max_error": 40.0}])
def test_joints_go_where_all_faces_stay(tmp_path, goal):
    rig(tmp_path / "in.usda")
    prim, stage = simplified(tmp_path, joints=2, **goal)
    assert (prim.status, prim.faces_after, prim.joints.after) == ("simplified", prim.faces_before, 2)
    weights = np.array(binding(stage).GetJointWeightsAttr().Get())
    joints = np.array(binding(stage).GetJointIndicesAttr().Get())
    assert len(np.unique(joints[weights > 0])) == 2
    assert prim.notes == [f"{TUBE}: keeps its faces, and is written as triangles for joints"]
    assert prim.measured is not None


def test_more_joints_stay_on_a_kept_mesh_where_a_limit_asks_for_them(tmp_path):
    rig(tmp_path / "in.usda")
    prim, _ = simplified(tmp_path, joints=2, max_error=0.5)
    assert (prim.status, prim.faces_after) == ("simplified", prim.faces_before)
    assert prim.joints.after > 2
    assert prim.measured["hausdorff"] <= 0.5
    assert any("joints stay, as" in note for note in prim.notes)


def test_influences_are_limited_where_all_faces_stay(tmp_path):
    rig(tmp_path / "in.usda")
    _, stage = simplified(tmp_path, influences=1)
    assert binding(stage).GetJointWeightsPrimvar().GetElementSize() == 1


def test_blend_shapes_go_where_all_faces_stay(tmp_path):
    shaped_rig(tmp_path / "in.usda")
    prim, stage = simplified(tmp_path, shapes=2)
    assert prim.shapes.after == 2
    assert len(binding(stage).GetBlendShapesAttr().Get()) == 2


def test_a_skin_is_baked_where_all_faces_stay(tmp_path):
    stage = rig(tmp_path / "in.usda")
    prim, out = simplified(tmp_path, bake=True)
    assert prim.status == "simplified"
    assert UsdGeom.Mesh(out.GetPrimAtPath(TUBE)).GetPointsAttr().GetNumTimeSamples() > 1
    assert not binding(out).GetJointWeightsAttr().HasAuthoredValue()
    before = UsdGeom.Mesh(stage.GetPrimAtPath(TUBE)).GetFaceVertexIndicesAttr().Get()
    after = UsdGeom.Mesh(out.GetPrimAtPath(TUBE)).GetFaceVertexIndicesAttr().Get()
    assert len(before) == len(after)
    assert prim.measured["hausdorff"] < 1e-4


@pytest.mark.parametrize(("authored", "normals", "changes"), [(True, "none", True), (False, "fit", True),
                                                             (False, "none", False), (True, "fit", False),
                                                             (True, "keep", False), (True, None, False)])  # fmt: skip
def test_normals_are_as_asked_for_where_all_faces_stay(tmp_path, authored, normals, changes):
    stage = cloth_stage(tmp_path / "in.usda")
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth"))
    if authored:
        mesh.CreateNormalsAttr([(0.0, 0.0, 1.0)] * len(mesh.GetPointsAttr().Get(1.0)))
        mesh.SetNormalsInterpolation("vertex")
    stage.Save()
    prim, out = simplified(tmp_path, normals=normals)
    assert prim.status == ("simplified" if changes else "kept")
    shown = UsdGeom.Mesh(out.GetPrimAtPath("/Root/Cloth"))
    has_normals = shown.GetNormalsAttr().HasAuthoredValue() or UsdGeom.PrimvarsAPI(shown).HasPrimvar("normals")
    assert bool(has_normals) == (normals == "fit" or (authored and normals != "none"))


@pytest.mark.parametrize("options", [{}, {"joints": 9}, {"influences": 9}, {"shapes": 9}, {"normals": "none"}])
def test_a_mesh_that_is_as_asked_for_is_left_as_it_is(tmp_path, options):
    shaped_rig(tmp_path / "in.usda")
    prim, _ = simplified(tmp_path, **options)
    assert (prim.status, prim.message, prim.notes) == ("kept", "the mesh has no more faces than asked for", [])


@given(st.floats(1e-9, 100.0), st.floats(0.01, 1.0))
def test_a_share_of_a_limit_never_asks_for_more_than_single_precision_gives(limit, share):
    part = part_of_limit("max_error", limit, share)
    assert 0 < part <= limit
    assert part_of_limit("max_distance", limit, share) == share * limit
    try:
        DistanceLimit(part / 100.0).check_provable()
    except OptionError:
        # The message then names the limit that was given.
        assert part == limit
    else:
        assert part == pytest.approx(share * limit) or math.isclose(part, 100.0 * 2.0**-24)


def test_a_limit_that_blend_shapes_break_is_said_to_be_broken(tmp_path):
    """Of a skin that is not linear it is not calculated what it makes of fewer shapes."""
    stage = shaped_rig(tmp_path / "in.usda")
    binding(stage).CreateSkinningMethodAttr("dualQuaternion")
    stage.Save()
    prim, _ = simplified(tmp_path, ratio=None, max_error=0.01, shapes=1)
    assert prim.measured["hausdorff"] > 0.01
    assert prim.measured["verdict"] != "good"
    assert any("does not hold for the skin as it is written: a point is" in text for text in prim.problems)


@pytest.mark.parametrize("options", [{"joints": 1}, {"influences": 1}, {"shapes": 1}])
def test_a_mesh_of_which_nothing_may_go_within_a_limit_is_left_as_it_is(tmp_path, options):
    shaped_rig(tmp_path / "in.usda")
    prim, stage = simplified(tmp_path, ratio=1.0, max_error=1e-5, **options)
    assert (prim.status, prim.faces_after, prim.problems) == ("kept", prim.faces_before, [])
    assert any("stay, as max_error 1e-05 %" in n or "a point, as max_error 1e-05 %" in n for n in prim.notes)
    assert not stage.GetRootLayer().GetPrimAtPath(TUBE)
