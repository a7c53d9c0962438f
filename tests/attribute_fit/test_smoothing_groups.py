"""Polygons without normals: which of their edges are shaded hard, as pictures show them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import UsdGeom

from tests.support import meshes
from tests.support.usd_stages import cloth_stage
from warpqem.mesh.smooth_normals import SmoothingGroups
from warpqem.picture.look import CREASE_ANGLE, corner_normals, smoothing_groups
from warpqem.usd import CompareOptions, SimplifyOptions, compare_stage_images, simplify_stage

POINTS = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [1, 0, 1]], dtype=np.float32)
FACES = np.array([[0, 1, 2], [2, 1, 3]], dtype=np.int32)


@pytest.mark.parametrize(("bend", "sharp"), [(0.0, False), (59.0, False), (61.0, True), (120.0, True)])
def test_edges_are_sharp_from_an_angle_on(bend, sharp):
    points = POINTS.copy()
    # The last point turns about the edge that both faces share.
    axis = (POINTS[2] - POINTS[1]) / np.sqrt(2)
    away = POINTS[3] - POINTS[1]
    away = away - (away @ axis) * axis
    angle = np.radians(bend)
    moved = np.cos(angle) * away + np.sin(angle) * np.cross(axis, away)
    points[3] = POINTS[3] - away + moved
    normals = SmoothingGroups(FACES, 60.0).normals(points)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=2), 1.0)
    # Both faces are as large, so that what they share is halfway between them.
    between = np.degrees(np.arccos(np.clip((normals[0, 0] * normals[0, 1]).sum(), -1, 1)))
    assert between == pytest.approx(0.0 if sharp else bend / 2, abs=1e-3)
    shared = np.allclose(normals[0, 1], normals[1, 1]) and np.allclose(normals[0, 2], normals[1, 0])
    assert shared == (not sharp or bend == 0.0)


def test_faces_without_area_have_no_sharp_edges():
    faces = np.array([[0, 1, 2], [1, 3, 3], [2, 1, 3]], dtype=np.int32)
    points = POINTS.copy()
    points[3] = (POINTS[1] + POINTS[2]) / 2
    normals = SmoothingGroups(faces, 60.0).normals(points)
    np.testing.assert_allclose(normals[2, :2], normals[0, [2, 1]])


@pytest.mark.parametrize("bend", [10.0, 50.0, 75.0])
def test_normals_are_those_that_pictures_show(bend):
    points, faces = meshes.grid(12, 12)
    points = points.astype(np.float32)
    # Rows go up and down by an angle, and differ a little.
    step = points[1, 0] - points[0, 0] or points[:, 0].max() / 12
    row = np.round(points[:, 0] / step).astype(int)
    points[:, 2] = step * np.tan(np.radians(bend / 2)) * (row % 2) + 0.1 * step * np.sin(points[:, 1] * 20)
    expected = corner_normals(points, faces, smoothing_groups(points, faces))
    np.testing.assert_allclose(SmoothingGroups(faces, CREASE_ANGLE).normals(points), expected, atol=1e-5)


def test_polygons_without_normals_keep_their_sharp_edges(tmp_path: Path):
    stage = cloth_stage(tmp_path / "in.usda", times=None)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth"))
    mesh.CreateSubdivisionSchemeAttr("none")
    points = np.array(mesh.GetPointsAttr().Get())
    # A roof: flat on both sides of a ridge of 90 degrees.
    middle = (points[:, 0].min() + points[:, 0].max()) / 2
    points[:, 2] = -np.abs(points[:, 0] - middle)
    mesh.GetPointsAttr().Set([tuple(map(float, point)) for point in points])
    stage.Save()
    options = SimplifyOptions(ratio=0.3, normals="fit", measure=False, device="cpu")
    simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options)
    compared = CompareOptions(device="cpu")
    [report] = compare_stage_images(tmp_path / "in.usda", tmp_path / "out.usda", compared, size=96)
    assert report.score.silhouette > 0.99
    assert report.score.gray.psnr is None or report.score.gray.psnr > 40
