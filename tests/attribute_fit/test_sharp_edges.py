"""Edges at which polygons without normals are shaded hard."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import UsdGeom

from tests.support.usd_stages import cloth_stage
from warpqem.mesh.smooth_normals import sharp_edges
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
    found = sharp_edges(points, FACES, 60.0)
    assert [sorted(edge) for edge in found.tolist()] == ([[1, 2]] if sharp else [])


def test_faces_without_area_have_no_sharp_edges():
    assert len(sharp_edges(POINTS, np.array([[0, 1, 2], [2, 1, 2]], dtype=np.int32), 60.0)) == 0


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
