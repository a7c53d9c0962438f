"""Fewer joints for the meshes of a stage."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdSkel

from tests.support.cli import run
from tests.support.usd_rig import ANIMATION, NAMES, SKELETON, TUBE, baked, rig, rms
from warpqem.errors import OptionError
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.commands.option_values import read_options
from warpqem.usd.write.stage_report import PrimReport


def simplified(folder: Path, **options: object) -> tuple[Usd.Stage, PrimReport]:
    report = simplify_stage(
        folder / "in.usda", folder / "out.usda", SimplifyOptions(**{"ratio": 0.2, "device": "cpu", **options})
    )
    assert report.prims[0].status == "simplified"
    # Flattened, because the next run writes the same file.
    return Usd.Stage.Open(Usd.Stage.Open(str(folder / "out.usda")).Flatten()), report.prims[0]


def binding(stage: Usd.Stage, mesh: str = TUBE) -> UsdSkel.BindingAPI:
    return UsdSkel.BindingAPI(stage.GetPrimAtPath(mesh))


def test_mesh_gets_an_order_of_its_own_without_the_joints_that_went(tmp_path):
    rig(tmp_path / "in.usda")
    stage, report = simplified(tmp_path, joints=3)
    order = list(binding(stage).GetJointsAttr().Get())
    assert len(order) == 3
    assert set(order) | set(report.joints.removed) == set(NAMES)
    indices = np.array(binding(stage).GetJointIndicesPrimvar().Get())
    assert set(indices) <= {0, 1, 2}
    assert (report.joints.before, report.joints.after) == (5, 3)


def test_skeleton_and_animation_stay(tmp_path):
    source = rig(tmp_path / "in.usda")
    stage, _ = simplified(tmp_path, joints=3)
    for path in (SKELETON, ANIMATION):
        before, after = (item.GetPrimAtPath(path) for item in (source, stage))
        assert all(after.GetAttribute(a.GetName()).Get(2.0) == a.Get(2.0) for a in before.GetAuthoredAttributes())


def test_joint_that_never_turns_goes_first_and_adds_nothing(tmp_path):
    source = rig(tmp_path / "in.usda")
    stage, report = simplified(tmp_path, joint_error=0.01)
    assert report.joints.removed == ["a/b/c/d/tip"]
    assert report.joints.heirs == ["a/b/c/d"]
    plain, _ = simplified(tmp_path)
    assert rms(source, stage) < 1.05 * rms(source, plain)


def test_baked_output_is_as_far_as_the_report_says(tmp_path):
    source = rig(tmp_path / "in.usda")
    stage, report = simplified(tmp_path, joints=3)
    assert rms(source, stage) == pytest.approx(report.measured["rms"], rel=0.15)
    _, before = simplified(tmp_path)
    added = np.hypot(before.measured["rms"], report.joints.added_error)
    assert report.measured["rms"] == pytest.approx(added, rel=0.3)


def test_each_level_has_its_own_number_of_joints_and_influences(tmp_path):
    rig(tmp_path / "in.usda")
    options = SimplifyOptions(lods=(0.4, 0.2), joints=(4, 2), influences=(3, 1), device="cpu")
    report = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options)
    assert [prim.joints.after for prim in report.prims] == [4, 2]
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    for level, (joints, influences) in enumerate([(4, 3), (2, 1)], start=1):
        stage.GetDefaultPrim().GetVariantSet("LOD").SetVariantSelection(f"LOD{level}")
        assert len(binding(stage).GetJointsAttr().Get()) == joints
        assert binding(stage).GetJointIndicesPrimvar().GetElementSize() == influences


def test_without_an_animation_a_note_says_so(tmp_path):
    rig(tmp_path / "in.usda", animated=False)
    _, report = simplified(tmp_path, joints=4)
    assert report.joints.removed == ["a/b/c/d/tip"]
    assert "nothing animates it" in report.notes[0]
    _, report = simplified(tmp_path, joint_error=1.0)
    assert report.joints is None
    assert "all joints stay" in report.notes[0]


def test_influences_without_an_animation_are_the_largest_and_a_note_says_so(tmp_path):
    rig(tmp_path / "in.usda", animated=False)
    _, report = simplified(tmp_path, influences=1)
    assert (
        "nothing animates it, so that the rest pose alone is known and the largest influences stay" in report.notes[0]
    )
    _, report = simplified(tmp_path, influences=3)
    assert report.notes == []


def test_joints_that_move_a_mesh_as_a_whole_stay_with_a_note(tmp_path):
    stage = rig(tmp_path / "in.usda")
    for name in ("primvars:skel:jointIndices", "primvars:skel:jointWeights"):
        stage.GetPrimAtPath(TUBE).RemoveProperty(name)
    binding(stage).CreateJointIndicesPrimvar(True, 2).Set([1, 2])
    binding(stage).CreateJointWeightsPrimvar(True, 2).Set([0.25, 0.75])
    stage.Save()
    _, report = simplified(tmp_path, joints=1)
    assert report.notes == [f"{TUBE}: 2 joints stay, as they move the whole mesh as one; asked for: 1"]


def test_poses_of_another_file_decide(tmp_path):
    rig(tmp_path / "in.usda", animated=False)
    rig(tmp_path / "clip.usda")
    _, report = simplified(tmp_path, joint_error=0.01, poses=tmp_path / "clip.usda")
    assert report.joints.removed == ["a/b/c/d/tip"]


def test_limit_on_the_distance_holds_for_the_skin_with_fewer_joints(tmp_path):
    source = rig(tmp_path / "in.usda")
    stage, report = simplified(tmp_path, ratio=None, max_error=3.0, joints=4)
    assert report.joints.after == 4
    assert report.measured["hausdorff"] <= 3.0
    assert rms(source, stage) <= 3.0


def nearest(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Distances (N,) of points from the nearest of triangles (T, 3, 3), one by one (Ericson 2005, 5.1.5, by parts)."""
    found = np.full(len(points), np.inf)
    for a, b, c in triangles:
        normal = np.cross(b - a, c - a)
        area = normal @ normal
        if area > 0:
            away = points - a
            second = np.cross(away, c - a) @ normal / area
            third = np.cross(b - a, away) @ normal / area
            inside = (second >= 0) & (third >= 0) & (second + third <= 1)
            found = np.where(inside, np.minimum(found, np.abs(away @ normal) / np.sqrt(area)), found)
        for start, end in ((a, b), (b, c), (c, a)):
            along = end - start
            part = np.clip((points - start) @ along / max(along @ along, 1e-300), 0, 1)
            found = np.minimum(found, np.linalg.norm(points - start - part[:, None] * along, axis=1))
    return found


def spots(triangles: np.ndarray) -> np.ndarray:
    """Corners, middles of edges and middles of triangles."""
    corners, middles = np.moveaxis(triangles, 1, 0), triangles.mean(axis=1)
    return np.concatenate([*corners, middles, (triangles[:, 0] + triangles[:, 1]) / 2])


def largest_distance(first: Usd.Stage, second: Usd.Stage) -> float:
    """Largest distance found over all frames, both ways, in % of the diagonal of the first mesh in the frame."""
    (before, faces), (after, new_faces) = baked(first), baked(second)
    largest = 0.0
    for pose, new in zip(before.astype(np.float64), after.astype(np.float64), strict=True):
        one, other = pose[faces], new[new_faces]
        away = max(nearest(spots(one), other).max(), nearest(spots(other), one).max())
        largest = max(largest, 100 * away / np.linalg.norm(np.ptp(pose[np.unique(faces)], axis=0)))
    return largest


@pytest.mark.parametrize(
    ("limit", "options"), [(1.0, {"joints": 2}), (3.0, {"joints": 3}), (2.0, {"joint_error": 5.0})]
)
def test_limit_holds_in_all_frames_and_more_joints_stay_where_it_would_not(tmp_path, limit, options):
    source = rig(tmp_path / "in.usda")
    stage, report = simplified(tmp_path, ratio=None, max_error=limit, **options)
    assert not report.problems
    assert 0.3 * limit < largest_distance(source, stage) <= limit
    asked = options.get("joints", 1)
    assert report.joints.after >= asked
    if report.joints.after > asked:
        given = "2" if "joints" in options and asked == 2 else "3" if "joints" in options else "joint_error 5 %"
        text = f"of 5 joints stay, as max_error {limit:g} % does not hold with fewer; asked for: {given}"
        assert any(text in note for note in report.notes)


def test_an_error_of_joints_that_leaves_more_than_asked_for_says_so(tmp_path):
    rig(tmp_path / "in.usda")
    _, report = simplified(tmp_path, joints=1, joint_error=0.01)
    assert report.joints.after == 4
    assert report.notes == [
        f"{TUBE}: 4 of 5 joints stay, as fewer would make more than joint_error 0.01 %; asked for: 1"
    ]


def test_joints_that_the_limit_allows_go(tmp_path):
    source = rig(tmp_path / "in.usda")
    stage, report = simplified(tmp_path, ratio=None, max_error=12.0, joints=3)
    assert (report.joints.after, report.notes) == (3, [])
    assert report.faces_after < 300
    assert largest_distance(source, stage) <= 12.0


def test_skin_that_cannot_be_fitted_keeps_its_joints_with_a_note(tmp_path):
    stage = rig(tmp_path / "in.usda")
    binding(stage).CreateSkinningMethodAttr("dualQuaternion")
    stage.Save()
    result, report = simplified(tmp_path, joints=2)
    assert not binding(result).GetJointsAttr().HasAuthoredValue()
    assert report.notes == [f"{TUBE}: all joints stay, as its skinning is not linear"]


def test_table_says_how_many_joints_are_left_and_which_went(tmp_path):
    rig(tmp_path / "in.usda")
    files = (str(tmp_path / "in.usda"), "-o", str(tmp_path / "out.usda"))
    shown = run("simplify", *files, "--ratio", "0.2", "--joints", "4", "--device", "cpu")
    assert shown.exit_code == 0
    assert "4 of 5" in shown.output
    assert "without the joints a/b/c/d/tip" in " ".join(shown.output.split())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"joints": "3,2"}, "joints has 2 values, and there are no levels"),
        ({"lods": "0.5,0.2", "ratio": None, "influences": "4,2,1"}, "influences has 3 values, and there are 2 levels"),
        ({"joints": "0"}, "joints must be a whole number at least 1, got 0"),
        ({"joints": "2", "bake": True}, "joints and joint_error exclude bake"),
        ({"joints": "two"}, "expected a whole number, or one for each level"),
        ({"joint_error": "-1"}, r"joint_error must be in \[0, 100\]"),
    ],
)
def test_wrong_options_are_named(options, message):
    with pytest.raises(OptionError, match=message):
        read_options({"ratio": 0.2, **options})
