"""Comparing files, and colouring meshes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom

from tests.support.usd_stages import FRAMES, cloth_stage, define_cloth, skinned_stage
from warpqem.errors import OptionError, StageError
from warpqem.usd import CompareOptions, FrameRange, SimplifyOptions, color_features, compare_stages, simplify_stage
from warpqem.usd.commands.motion_features import OUTSIDE_COLOR, feature_colors

CLOTH = "/Root/Cloth"


def two_files(tmp_path: Path, lift: float = 0.0, times: list[float] | None = FRAMES) -> tuple[Path, Path]:
    """A cloth, and the same lifted by a distance, sampled at `times`."""
    cloth_stage(tmp_path / "a.usda")
    stage = cloth_stage(tmp_path / "b.usda", times=times)
    points = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)).GetPointsAttr()
    for time in times or [Usd.TimeCode.Default()]:
        points.Set([p + Gf.Vec3f(0, 0, lift) for p in points.Get(time)], time)
    stage.Save()
    return tmp_path / "a.usda", tmp_path / "b.usda"


def compare(paths: tuple[Path, Path], **options: object):
    return compare_stages(*paths, CompareOptions(samples=200, device="cpu", **options))


def test_equal_meshes_have_no_distance(tmp_path):
    [pair] = compare(two_files(tmp_path))
    assert pair.times == FRAMES
    assert pair.comparison.hausdorff == pytest.approx(0, abs=1e-4)


def test_meshes_without_faces_have_nothing_to_compare(tmp_path):
    for name in ("a.usda", "b.usda"):
        stage = Usd.Stage.CreateNew(str(tmp_path / name))
        mesh = UsdGeom.Mesh.Define(stage, "/Empty")
        mesh.CreatePointsAttr([])
        mesh.CreateFaceVertexCountsAttr([])
        mesh.CreateFaceVertexIndicesAttr([])
        stage.Save()
    [pair] = compare((tmp_path / "a.usda", tmp_path / "b.usda"))
    assert pair.comparison is None
    assert pair.message is None


def test_lifted_mesh_is_off(tmp_path):
    [pair] = compare(two_files(tmp_path, lift=1.0))
    assert pair.comparison.rms > 1.0


def test_frames_are_the_union_of_both_files(tmp_path):
    [pair] = compare(two_files(tmp_path, times=[1.0, 3.0]))
    assert pair.times == [1.0, 2.0, 3.0, 4.0]


def test_skinned_mesh_is_compared_with_its_point_cache(tmp_path):
    skinned_stage(tmp_path / "in.usda")
    options = SimplifyOptions(ratio=0.9, device="cpu")
    simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options)
    [pair] = compare((tmp_path / "in.usda", tmp_path / "out.usda"))
    assert pair.times == FRAMES
    assert 0 < pair.comparison.rms < 2.0


def test_mesh_that_one_file_lacks_fails(tmp_path):
    paths = two_files(tmp_path)
    stage = Usd.Stage.Open(str(paths[0]))
    define_cloth(stage, "/Root/Flag")
    stage.Save()
    messages = {pair.path: pair.message for pair in compare(paths)}
    assert messages[CLOTH] is None
    assert "b.usda" in messages["/Root/Flag"]


def test_frame_range_limits_the_comparison(tmp_path):
    [pair] = compare(two_files(tmp_path), frames=FrameRange(2, 3))
    assert pair.times == [2.0]


def test_heat_map_colors_the_test_mesh_in_every_frame(tmp_path):
    paths = two_files(tmp_path, lift=0.5)
    [pair] = compare(paths, heatmap=str(tmp_path / "heat.usda"))
    stage = Usd.Stage.Open(str(tmp_path / "heat.usda"))
    colors = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)).GetDisplayColorPrimvar()
    assert colors.GetInterpolation() == "vertex"
    assert colors.GetTimeSamples() == FRAMES
    assert len(colors.Get(2.0)) == 81
    assert pair.heatmap_scale == pair.comparison.hausdorff


def test_heat_map_over_an_input_is_refused(tmp_path):
    paths = two_files(tmp_path)
    with pytest.raises(OptionError, match="never overwritten"):
        compare(paths, heatmap=str(paths[0]))


def test_report_is_plain_data(tmp_path):
    [pair] = compare(two_files(tmp_path))
    assert pair.to_dict()["comparison"]["frame_count"] == 3


def test_every_feature_has_its_own_color():
    colors = feature_colors(np.array([0, 1, 2, -1, 0], dtype=np.int32))
    assert len(np.unique(colors, axis=0)) == 4
    np.testing.assert_allclose(colors[3], OUTSIDE_COLOR, rtol=1e-6)
    np.testing.assert_array_equal(colors[0], colors[4])


def test_features_are_written_as_colors_of_the_authored_points(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    [report] = color_features(tmp_path / "in.usda", tmp_path / "out.usda", device="cpu")
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH))
    colors = np.array(mesh.GetDisplayColorPrimvar().Get())
    assert colors.shape == (81, 3)
    assert (np.abs(colors - OUTSIDE_COLOR).max(axis=1) > 1e-3).sum() == report.feature_vertices
    assert len(mesh.GetPointsAttr().Get(1.0)) == 81


def test_mesh_that_does_not_move_has_no_features(tmp_path):
    cloth_stage(tmp_path / "in.usda", times=None)
    [report] = color_features(tmp_path / "in.usda", tmp_path / "out.usda", device="cpu")
    assert "one pose only" in report.message
    assert not (tmp_path / "out.usda").exists()


def test_features_of_a_prim_that_does_not_exist_are_refused(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    with pytest.raises(StageError, match="/Nowhere"):
        color_features(tmp_path / "in.usda", tmp_path / "out.usda", prims=("/Nowhere",))
