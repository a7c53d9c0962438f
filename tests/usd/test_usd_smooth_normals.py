"""Normals of meshes that were subdivision surfaces."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from tests.support import meshes
from tests.support.usd_stages import FRAMES, cloth_stage
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.write.smooth_normals import vertex_normals

CLOTH = "/Root/Cloth"


def simplified(folder, prepare, flatten=False) -> UsdGeom.Mesh:
    stage = cloth_stage(folder / "in.usda")
    prepare(UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)))
    stage.Save()
    options = SimplifyOptions(ratio=0.4, device="cpu", flatten=flatten)
    simplify_stage(folder / "in.usda", folder / "out.usda", options)
    # A mesh does not keep its stage alive.
    simplified.stage = Usd.Stage.Open(str(folder / "out.usda"))
    return UsdGeom.Mesh(simplified.stage.GetPrimAtPath(CLOTH))


def test_normals_of_a_sphere_point_away_from_its_centre():
    points, faces = meshes.icosphere(3)
    np.testing.assert_allclose(vertex_normals(points, faces), points / 0.5, atol=0.01)


def test_normals_do_not_depend_on_how_a_square_is_cut():
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1]], dtype=np.float32)
    wall = [[0, 5, 1], [0, 4, 5]]
    first = vertex_normals(points, np.array([[0, 1, 2], [0, 2, 3], *wall], dtype=np.int32))
    second = vertex_normals(points, np.array([[0, 1, 3], [1, 2, 3], *wall], dtype=np.int32))
    np.testing.assert_allclose(first, second, atol=1e-6)


def test_face_without_area_has_no_say():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0]], dtype=np.float32)
    faces = np.array([[0, 1, 2], [0, 1, 3]], dtype=np.int32)
    np.testing.assert_array_equal(vertex_normals(points, faces), np.tile([0, 0, 1], (4, 1)))


@pytest.mark.parametrize("orientation", ["rightHanded", "leftHanded"])
def test_subdivision_surface_gets_normals_in_every_frame(orientation, tmp_path, flatten):
    def prepare(mesh):
        mesh.GetSubdivisionSchemeAttr().Set("catmullClark")
        mesh.CreateOrientationAttr(orientation)

    mesh = simplified(tmp_path, prepare, flatten)
    assert mesh.GetNormalsInterpolation() == "vertex"
    assert mesh.GetNormalsAttr().GetTimeSamples() == FRAMES
    for time in FRAMES:
        normals = np.array(mesh.GetNormalsAttr().Get(time))
        assert len(normals) == len(mesh.GetPointsAttr().Get(time))
        assert (normals[:, 2] > 0 if orientation == "rightHanded" else normals[:, 2] < 0).all()


@pytest.mark.parametrize("scheme", ["none", "bilinear"])
def test_polygons_get_no_normals(scheme, tmp_path):
    mesh = simplified(tmp_path, lambda mesh: mesh.GetSubdivisionSchemeAttr().Set(scheme))
    assert not mesh.GetNormalsAttr().HasAuthoredValue()


def test_creased_surface_gets_no_normals(tmp_path):
    def prepare(mesh):
        mesh.GetSubdivisionSchemeAttr().Set("catmullClark")
        mesh.CreateCreaseIndicesAttr([20, 21])
        mesh.CreateCreaseLengthsAttr([2])
        mesh.CreateCreaseSharpnessesAttr([10.0])

    assert not simplified(tmp_path, prepare).GetNormalsAttr().HasAuthoredValue()
