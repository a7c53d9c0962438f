"""Poses in which nobody sees a mesh."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Usd, UsdGeom, Vt

from tests.support.usd_stages import cloth_stage
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.read.visibility import seen_frames

TIMES = [float(time) for time in range(1, 9)]


@pytest.mark.parametrize("path", ["/Root", "/Root/Cloth"])
def test_poses_that_show_before_or_after_a_visible_time_are_seen(path):
    stage = cloth_stage(size=2, times=TIMES)
    visibility = UsdGeom.Imageable(stage.GetPrimAtPath(path)).CreateVisibilityAttr()
    for time, value in ((1, "invisible"), (4, "inherited"), (6, "invisible")):
        visibility.Set(value, time)
    # Up to the change at 6 the mesh is visible, and moves towards its pose at 6.
    seen = seen_frames(stage.GetPrimAtPath("/Root/Cloth"), TIMES)
    assert [time for time, shows in zip(TIMES, seen, strict=True) if shows] == [4, 5, 6]


def test_change_between_two_poses_shows_both():
    stage = cloth_stage(size=2, times=TIMES)
    visibility = UsdGeom.Imageable(stage.GetPrimAtPath("/Root/Cloth")).CreateVisibilityAttr()
    visibility.Set("invisible", 0.0)
    visibility.Set("inherited", 3.25)
    visibility.Set("invisible", 3.5)
    seen = seen_frames(stage.GetPrimAtPath("/Root/Cloth"), TIMES)
    assert [time for time, shows in zip(TIMES, seen, strict=True) if shows] == [3, 4]


def test_mesh_that_is_always_invisible_counts_in_all_poses():
    stage = cloth_stage(size=2, times=TIMES)
    UsdGeom.Imageable(stage.GetPrimAtPath("/Root/Cloth")).CreateVisibilityAttr().Set("invisible")
    assert seen_frames(stage.GetPrimAtPath("/Root/Cloth"), TIMES).all()


def faces_of_hidden_crumple(tmp_path, hidden: bool, **options: object) -> tuple[np.ndarray, list[float]]:
    """Faces, and the times of the points, of a flat sheet that is crumpled from time 5 on."""
    stage = cloth_stage(size=8, times=TIMES)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth"))
    points, rng = np.array(mesh.GetPointsAttr().Get(1.0)), np.random.default_rng(3)
    for time in TIMES:
        points[:, 2] = 0.02 * np.sin(points[:, 0] + time) if time < 5 else rng.normal(0, 1, len(points))
        mesh.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(points), time)
    if hidden:
        mesh.CreateVisibilityAttr().Set("inherited", 1)
        mesh.GetVisibilityAttr().Set("invisible", 4)
    name = tmp_path / f"{hidden}.usda"
    stage.GetRootLayer().Export(str(name))
    simplify_stage(name, tmp_path / f"{hidden}_out.usda", SimplifyOptions(**options))
    opened = Usd.Stage.Open(str(tmp_path / f"{hidden}_out.usda"))
    simplified = UsdGeom.Mesh(opened.GetPrimAtPath("/Root/Cloth"))
    return np.array(simplified.GetFaceVertexCountsAttr().Get()), simplified.GetPointsAttr().GetTimeSamples()


def test_hidden_poses_do_not_count_in_the_error_but_are_written(tmp_path):
    shown, _ = faces_of_hidden_crumple(tmp_path, hidden=False, max_error=1.0)
    hidden, times = faces_of_hidden_crumple(tmp_path, hidden=True, max_error=1.0)
    assert len(hidden) < 0.5 * len(shown)
    assert times == TIMES
