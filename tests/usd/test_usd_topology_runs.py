"""Meshes whose topology varies over time: captures and remeshed simulations, done run by run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdSkel, Vt

from tests.support.usd_topology_runs import HELD, PATH, bumps, capture, check_at, define_capture, simplified
from warpqem.errors import OptionError, StageError
from warpqem.usd import FrameRange, SimplifyOptions, simplify_stage
from warpqem.usd.read.topology_runs import find_runs


def height_error(mesh: UsdGeom.Mesh, time: float) -> float:
    """Largest distance in height of the used points from the sheet that was captured."""
    points = np.asarray(mesh.GetPointsAttr().Get(time))[np.unique(mesh.GetFaceVertexIndicesAttr().Get(time))]
    return float(np.abs(points[:, 2] - 0.2 * np.sin(5 * points[:, 0] + 0.3 * time) * np.cos(4 * points[:, 1])).max())


@pytest.mark.parametrize("every_frame", [False, True], ids=["sample per run", "sample per frame"])
def test_capture_of_five_runs_has_the_same_runs_at_the_same_times(every_frame, tmp_path):
    sizes = [12, 14, 10, 13, 11]
    before = capture(tmp_path / "in.usda", sizes, 12, every_frame=every_frame)
    report, after = simplified(tmp_path, ratio=0.3)
    assert (report.status, report.frames, report.dropped) == ("simplified", 60, [])
    for name in ("points", "velocities", "extent", "faceVertexCounts", "faceVertexIndices", "primvars:heat"):
        attributes = [mesh.GetPrim().GetAttribute(name) for mesh in (before, after)]
        assert attributes[0].GetTimeSamples() == attributes[1].GetTimeSamples(), name
    for time in np.arange(0, 60, 0.5):
        check_at(after, float(time))
    for run, size in enumerate(sizes):
        count = len(after.GetFaceVertexCountsAttr().Get(12.0 * run))
        assert count in (round(0.3 * 2 * size * size), round(0.3 * 2 * size * size) - 1)
        assert report.runs[run].faces_after == count
    assert max(height_error(after, float(time)) for time in range(60)) < 0.03


def test_run_has_the_bits_of_a_mesh_of_its_own(tmp_path):
    capture(tmp_path / "in.usda", [10, 12], 4)
    _, after = simplified(tmp_path, ratio=0.3)
    (tmp_path / "alone").mkdir()
    capture(tmp_path / "alone" / "in.usda", [10], 4)
    _, alone = simplified(tmp_path / "alone", ratio=0.3)
    for name in ("points", "faceVertexIndices", "primvars:heat", "primvars:patch"):
        values = [np.asarray(mesh.GetPrim().GetAttribute(name).Get(2.0)) for mesh in (after, alone)]
        np.testing.assert_array_equal(*values)


def test_points_are_held_up_to_a_change_of_topology(tmp_path):
    # Both runs come out with as many points: USD would blend them.
    capture(tmp_path / "in.usda", [10, 10], 1)
    stage = Usd.Stage.Open(str(tmp_path / "in.usda"))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(PATH))
    indices = np.asarray(mesh.GetFaceVertexIndicesAttr().Get(1.0)).reshape(-1, 4)
    mesh.GetFaceVertexIndicesAttr().Set(Vt.IntArray.FromNumpy(np.ascontiguousarray(indices[::-1].ravel())), 1.0)
    stage.Save()
    report, after = simplified(tmp_path, ratio=0.3)
    assert len(report.runs) == 2
    points = [np.asarray(after.GetPointsAttr().Get(time)) for time in (0.0, 0.5, 1.0)]
    np.testing.assert_array_equal(points[0], points[1])
    assert len(points[0]) != len(points[2])
    check_at(after, 0.5)
    check_at(after, 1.0)


def test_mesh_that_differs_in_every_frame_is_done_frame_by_frame_with_a_note(tmp_path):
    capture(tmp_path / "in.usda", [8, 9, 10, 9], 1)
    report, after = simplified(tmp_path, ratio=0.5)
    assert [(run.frames, run.faces_before) for run in report.runs] == [(1, 128), (1, 162), (1, 200), (1, 162)]
    [note] = report.notes
    assert note == (
        f"{PATH}: topology differs in each of 4 frames (64 to 100 faces); "
        "each frame was simplified for itself, so nothing keeps vertices steady from one to the next"
    )
    for time in range(4):
        check_at(after, float(time))
        assert height_error(after, float(time)) < 0.04


def test_frames_within_one_run_give_a_plain_mesh(tmp_path):
    capture(tmp_path / "in.usda", [10, 12, 9], 6)
    report, after = simplified(tmp_path, ratio=0.3, frames=FrameRange(7, 10))
    assert (report.frames, report.runs, report.notes) == (4, [], [])
    assert after.GetPointsAttr().GetTimeSamples() == [7, 8, 9, 10]
    assert after.GetFaceVertexCountsAttr().GetTimeSamples() == []
    check_at(after, 8.5)


def test_frames_over_two_runs_leave_the_others_out(tmp_path):
    capture(tmp_path / "in.usda", [10, 12, 9], 4)
    report, after = simplified(tmp_path, ratio=0.3, frames=FrameRange(2, 5, 0.5))
    assert [(run.first_time, run.last_time, run.frames) for run in report.runs] == [(2, 3.5, 4), (4, 5, 3)]
    assert after.GetPointsAttr().GetTimeSamples() == [2, 2.5, 3, 3.5, 4, 4.5, 5]
    # Between the last sample of a run and the next run the pose is held.
    np.testing.assert_allclose(after.GetPointsAttr().Get(3.5), after.GetPointsAttr().Get(3.0), atol=1e-6)


def test_points_that_stay_while_faces_change_are_done_at_each_change(tmp_path):
    stage = Usd.Stage.CreateNew(str(tmp_path / "in.usda"))
    mesh = UsdGeom.Mesh.Define(stage, PATH)
    points, counts, indices = bumps(10, 0.0)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    for time, count in ((1.0, 100), (4.0, 50)):
        mesh.CreateFaceVertexCountsAttr().Set(Vt.IntArray.FromNumpy(counts[:count]), time)
        mesh.CreateFaceVertexIndicesAttr().Set(Vt.IntArray.FromNumpy(indices[: 4 * count]), time)
    stage.Save()
    report, after = simplified(tmp_path, ratio=0.5, quality="fast")
    assert [run.faces_after for run in report.runs] == [100, 50]
    assert after.GetPointsAttr().GetTimeSamples() == [1, 4]
    for time in (0.0, 1.0, 3.0, 4.0, 9.0):
        check_at(after, time)


def test_error_limit_holds_in_each_run(tmp_path):
    capture(tmp_path / "in.usda", [16, 24], 3)
    report, after = simplified(tmp_path, max_error=1.0)
    assert len(report.runs) == 2
    assert all(run.faces_after < run.faces_before for run in report.runs)
    assert max(height_error(after, float(time)) for time in range(6)) < 0.02


def test_frame_without_a_mesh_stays_without_one(tmp_path):
    capture(tmp_path / "in.usda", [10, 12], 2)
    stage = Usd.Stage.Open(str(tmp_path / "in.usda"))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(PATH))
    for name in ("points", "velocities", "faceVertexCounts", "faceVertexIndices", "primvars:st", "primvars:heat"):
        attribute = mesh.GetPrim().GetAttribute(name)
        attribute.Set(type(attribute.Get(0.0))(), 2.0)
    stage.GetPrimAtPath(f"{PATH}/half").GetAttribute("indices").Set(Vt.IntArray(), 2.0)
    stage.GetPrimAtPath(PATH).GetAttribute("primvars:patch").Set(Vt.IntArray(), 2.0)
    mesh.GetPrim().GetAttribute("points").Set(Vt.Vec3fArray.FromNumpy(bumps(12, 3.0)[0]), 3.0)
    for name, value in (("faceVertexCounts", bumps(12, 3.0)[1]), ("faceVertexIndices", bumps(12, 3.0)[2])):
        mesh.GetPrim().GetAttribute(name).Set(Vt.IntArray.FromNumpy(value), 3.0)
    for name in ("primvars:st", "primvars:patch"):
        mesh.GetPrim().GetAttribute(name).Clear()
    stage.RemovePrim(f"{PATH}/half")
    stage.Save()
    report, after = simplified(tmp_path, ratio=0.3)
    assert [run.faces_after for run in report.runs] == pytest.approx([60, 0, 86], abs=1)
    assert len(after.GetPointsAttr().Get(2.0)) == len(after.GetFaceVertexIndicesAttr().Get(2.0)) == 0
    check_at(after, 1.0)
    check_at(after, 3.0)


def test_refuse_leaves_the_mesh_with_an_error(tmp_path):
    capture(tmp_path / "in.usda", [10, 12], 2)
    options = SimplifyOptions(ratio=0.5, device="cpu", varying_topology="refuse")
    [failed] = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options).failed
    assert failed.message == (
        f"{PATH}.faceVertexCounts: changes at time 2; a mesh whose topology varies over time cannot be simplified"
    )
    assert not (tmp_path / "out.usda").exists()


def test_another_way_with_varying_topology_is_refused():
    with pytest.raises(OptionError, match="varying_topology must be 'runs' or 'refuse', got 'keep'"):
        SimplifyOptions(ratio=0.5, varying_topology="keep")


def test_run_that_cannot_be_read_is_named_with_its_times_and_nothing_is_written_of_the_mesh(tmp_path):
    capture(tmp_path / "in.usda", [10, 12], 2)
    stage = Usd.Stage.Open(str(tmp_path / "in.usda"))
    define_capture(stage, [8], 2, path="/Root/Other")
    points = UsdGeom.Mesh(stage.GetPrimAtPath(PATH)).GetPointsAttr()
    bad = np.array(points.Get(3.0))
    bad[5] = np.nan
    points.Set(Vt.Vec3fArray.FromNumpy(bad), 3.0)
    stage.Save()
    report = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(ratio=0.5, device="cpu"))
    [failed] = report.failed
    assert str(failed.message).startswith(f"{PATH}, times 2 to 3: {PATH}.points: point 5 at time 3 is [nan")
    edits = Sdf.Layer.FindOrOpen(str(tmp_path / "out.usda"))
    assert edits.GetPrimAtPath("/Root/Other")
    assert not edits.GetPrimAtPath(PATH)


def test_skinned_mesh_of_varying_topology_is_refused(tmp_path):
    capture(tmp_path / "in.usda", [10, 12], 2)
    stage = Usd.Stage.Open(str(tmp_path / "in.usda"))
    root = stage.GetPrimAtPath("/Root")
    root.SetTypeName("SkelRoot")
    skeleton = UsdSkel.Skeleton.Define(stage, "/Root/Skel")
    skeleton.CreateJointsAttr(["a"])
    for attribute in (skeleton.CreateBindTransformsAttr, skeleton.CreateRestTransformsAttr):
        attribute(Vt.Matrix4dArray(1))
    binding = UsdSkel.BindingAPI.Apply(stage.GetPrimAtPath(PATH))
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    binding.CreateJointIndicesPrimvar(True, 1).Set([0])
    binding.CreateJointWeightsPrimvar(True, 1).Set([1.0])
    stage.Save()
    [failed] = simplify_stage(
        tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(ratio=0.5, device="cpu")
    ).failed
    assert "changes at time 2" in str(failed.message)


def test_flat_file_holds_the_runs(tmp_path):
    capture(tmp_path / "in.usda", [10, 12], 2)
    _, after = simplified(tmp_path, ratio=0.3, flatten=True)
    assert Sdf.Layer.FindOrOpen(str(tmp_path / "out.usda")).subLayerPaths == []
    for time in (0.0, 1.0, 1.5, 2.0, 3.0):
        check_at(after, time)


def test_levels_of_detail_hold_the_runs(tmp_path):
    capture(tmp_path / "in.usda", [10, 12], 2)
    simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(lods=(0.5, 0.2), device="cpu"))
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    for level, share in enumerate((1.0, 0.5, 0.2)):
        stage.GetDefaultPrim().GetVariantSet("LOD").SetVariantSelection(f"LOD{level}")
        mesh = UsdGeom.Mesh(stage.GetPrimAtPath(PATH))
        triangles = [sum(np.asarray(mesh.GetFaceVertexCountsAttr().Get(time)) - 2) for time in (0.0, 2.0)]
        assert triangles == pytest.approx([200 * share, 288 * share], abs=1)
        check_at(mesh, 1.5)


def mixed_runs(path: Path) -> UsdGeom.Mesh:
    """A card of one quad, a sheet whose points are split at a seam, and a card again, with values of every kind."""
    stage = Usd.Stage.CreateNew(str(path))
    mesh = UsdGeom.Mesh.Define(stage, PATH)
    stage.SetDefaultPrim(stage.GetPrimAtPath("/Root"))
    api = UsdGeom.PrimvarsAPI(mesh)
    st = api.CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, "vertex")
    tag = api.CreatePrimvar("tag", Sdf.ValueTypeNames.StringArray, "uniform")
    mesh.SetNormalsInterpolation("vertex")
    card = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float32)
    left, counts, indices = bumps(8, 1.0)
    # Two halves with points of their own at x = 1, and other texture coordinates there.
    right = left + np.float32([1, 0, 0])
    right[:, 2] = left[:, 2] + (0.2 * np.sin(5.3) - 0.2 * np.sin(0.3)) * np.cos(4 * left[:, 1])
    sheet = np.concatenate([left, right])
    sheet[np.flatnonzero(left[:, 0] == 0) + len(left)] = left[left[:, 0] == 1]
    uv = np.concatenate([left[:, :2], left[:, :2] + np.float32([0, 5])])
    shapes = [
        (card, [4], [0, 1, 2, 3], card[:, :2]),
        (sheet, [*counts, *counts], [*indices, *(indices + len(left))], uv),
        (card * 2, [4], [0, 1, 2, 3], card[:, :2]),
    ]
    for time, (points, polygons, corners, values) in enumerate(shapes):
        mesh.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(points), time)
        mesh.CreateFaceVertexCountsAttr().Set(Vt.IntArray([int(count) for count in polygons]), time)
        mesh.CreateFaceVertexIndicesAttr().Set(Vt.IntArray([int(corner) for corner in corners]), time)
        mesh.CreateNormalsAttr().Set(Vt.Vec3fArray(len(points), (0, 0, 1)), time)
        st.Set(Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(values)), time)
        tag.Set(Vt.StringArray([f"{time} {number}" for number in range(len(polygons))]), time)
    stage.Save()
    HELD.append(stage)
    return mesh


def test_runs_that_are_kept_stand_beside_others_in_one_interpolation(tmp_path):
    before = mixed_runs(tmp_path / "in.usda")
    report, after = simplified(tmp_path, ratio=0.3)
    assert [(run.faces_before, run.faces_after) for run in report.runs] == [(2, 2), (256, 76), (2, 2)]
    st = UsdGeom.PrimvarsAPI(after).GetPrimvar("st")
    # The sheet was welded at its seam, so that its points no longer have one value each.
    assert st.GetInterpolation() == "faceVarying"
    for time in (0.0, 1.0, 1.5, 2.0):
        check_at(after, time)
        corners = len(after.GetFaceVertexIndicesAttr().Get(time))
        sizes = {"vertex": len(after.GetPointsAttr().Get(time)), "faceVarying": corners}
        assert len(after.GetNormalsAttr().Get(time)) == sizes[after.GetNormalsInterpolation()]
    for time in (0.0, 2.0):
        np.testing.assert_array_equal(
            np.asarray(after.GetPointsAttr().Get(time))[:4], np.asarray(before.GetPointsAttr().Get(time))
        )
        assert after.GetFaceVertexCountsAttr().Get(time) == before.GetFaceVertexCountsAttr().Get(time)
        assert UsdGeom.PrimvarsAPI(after).GetPrimvar("tag").Get(time) == [f"{time:g} 0"]
        flat = np.asarray(st.ComputeFlattened(time))
        np.testing.assert_array_equal(flat, [[0, 0], [1, 0], [1, 1], [0, 1]])


def test_mesh_of_kept_runs_alone_is_left_as_it_is(tmp_path):
    capture(tmp_path / "in.usda", [1, 1], 1)
    stage = Usd.Stage.Open(str(tmp_path / "in.usda"))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(PATH))
    mesh.GetFaceVertexIndicesAttr().Set([3, 1, 0, 2], 1.0)
    stage.RemovePrim(f"{PATH}/half")
    stage.Save()
    report, _ = simplified(tmp_path, ratio=0.3)
    assert report.status == "kept"
    assert not Sdf.Layer.FindOrOpen(str(tmp_path / "out.usda")).GetPrimAtPath(PATH)


def test_topology_before_its_points_shows_what_was_there(tmp_path):
    before = capture(tmp_path / "in.usda", [8, 12], 1)
    stage = Usd.Stage.Open(str(tmp_path / "in.usda"))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(PATH))
    points = mesh.GetPointsAttr()
    later = points.Get(1.0)
    points.ClearAtTime(1.0)
    points.Set(later, 2.0)
    for name in ("primvars:st", "primvars:heat", "primvars:patch", "velocities"):
        mesh.GetPrim().RemoveProperty(name)
    stage.RemovePrim(f"{PATH}/half")
    stage.Save()
    assert [run.times for run in find_runs(UsdGeom.Mesh(before.GetPrim().GetStage().GetPrimAtPath(PATH)))] == [
        (0.0,),
        (2.0,),
    ]
    _, after = simplified(tmp_path, ratio=0.5)
    for time in (0.0, 1.0, 1.5, 2.0):
        check_at(after, time)


def test_faces_without_points_at_any_time_are_refused(tmp_path):
    stage = Usd.Stage.CreateNew(str(tmp_path / "in.usda"))
    mesh = UsdGeom.Mesh.Define(stage, PATH)
    mesh.CreatePointsAttr([(0, 0, 0), (1, 0, 0)])
    for time, indices in ((1.0, [0, 1, 2]), (2.0, [0, 2, 1])):
        mesh.CreateFaceVertexCountsAttr().Set([3], time)
        mesh.CreateFaceVertexIndicesAttr().Set(indices, time)
    with pytest.raises(StageError, match="at no time are the points there that faces refer to"):
        find_runs(mesh)
