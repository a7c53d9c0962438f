"""Normals of meshes that were subdivision surfaces."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pxr import Usd, UsdGeom

from tests.support import meshes
from tests.support.usd_stages import FRAMES, cloth_stage
from warpqem.mesh.smooth_normals import corner_groups, vertex_normals
from warpqem.usd import SimplifyOptions, simplify_stage

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


def creased_ridge(mesh: UsdGeom.Mesh, orientation: str = "rightHanded") -> None:
    """A roof of two slopes, creased along its ridge, at x = 4."""
    mesh.GetSubdivisionSchemeAttr().Set("catmullClark")
    mesh.CreateOrientationAttr(orientation)
    for time in FRAMES:
        points = np.array(mesh.GetPointsAttr().Get(time))
        points[:, 2] = 4 - np.abs(points[:, 0] - 4) + 0.1 * np.sin(points[:, 1] + time)
        mesh.GetPointsAttr().Set(points, time)
    ridge = [index for index, point in enumerate(points) if point[0] == 4]
    mesh.CreateCreaseIndicesAttr(ridge)
    mesh.CreateCreaseLengthsAttr([len(ridge)])
    mesh.CreateCreaseSharpnessesAttr([10.0])


@pytest.mark.parametrize("orientation", ["rightHanded", "leftHanded"])
def test_creased_surface_is_smooth_on_both_sides_of_a_crease(orientation, tmp_path, flatten):
    mesh = simplified(tmp_path, lambda mesh: creased_ridge(mesh, orientation), flatten)
    assert mesh.GetNormalsInterpolation() == "faceVarying"
    assert mesh.GetNormalsAttr().GetTimeSamples() == FRAMES
    faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    for time in FRAMES:
        normals = np.array(mesh.GetNormalsAttr().Get(time)).reshape(-1, 3, 3)
        corners = np.array(mesh.GetPointsAttr().Get(time))[faces]
        # All corners of a slope lean its way, those on the ridge as well.
        left = corners[:, :, 0].mean(axis=1) < 4
        sign = 1 if orientation == "rightHanded" else -1
        assert (sign * normals[left][:, :, 0] < -0.4).all()
        assert (sign * normals[~left][:, :, 0] > 0.4).all()


def test_crease_that_is_no_edge_any_more_leaves_normals_of_points(tmp_path):
    def prepare(mesh):
        mesh.GetSubdivisionSchemeAttr().Set("catmullClark")
        mesh.CreateCreaseIndicesAttr([20, 99])
        mesh.CreateCreaseLengthsAttr([2])
        mesh.CreateCreaseSharpnessesAttr([10.0])

    mesh = simplified(tmp_path, prepare)
    assert mesh.GetNormalsInterpolation() == "vertex"
    assert len(mesh.GetNormalsAttr().Get(FRAMES[0])) == len(mesh.GetPointsAttr().Get(FRAMES[0]))


def test_corners_that_a_hard_edge_parts_have_groups_of_their_own():
    # A fan of four around vertex 0; two hard edges part it, one alone does not.
    fan = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1]], dtype=np.int32)
    assert len(np.unique(corner_groups(fan, np.array([[0, 1], [0, 3]]))[:, 0])) == 2
    assert len(np.unique(corner_groups(fan, np.array([[0, 1]]))[:, 0])) == 1
    np.testing.assert_array_equal(corner_groups(fan, np.zeros((0, 2), dtype=np.int32))[:, 0], 0)


@given(st.lists(st.sampled_from(range(162)), min_size=2, max_size=40), st.booleans())
def test_groups_of_corners_refine_vertices_and_do_not_cross_hard_edges(chain, turned):
    _, faces = meshes.icosphere(2)
    faces = faces[:, ::-1] if turned else faces
    hard = np.stack([chain[:-1], chain[1:]], axis=1)
    group = corner_groups(faces, hard)
    vertex_of = {}
    for name, vertex in zip(group.ravel().tolist(), faces.ravel().tolist(), strict=True):
        assert vertex_of.setdefault(name, vertex) == vertex
    # Without the hard edges around it a vertex is in as many groups as they part it into.
    edges = {tuple(sorted(pair)) for face in faces.tolist() for pair in itertools.combinations(face, 2)}
    cuts = {tuple(sorted(pair)) for pair in hard.tolist()} & edges
    for vertex in range(162):
        degree = sum(vertex in cut for cut in cuts)
        assert len(np.unique(group[faces == vertex])) == max(degree, 1)
