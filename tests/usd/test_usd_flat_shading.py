"""Flat shading stays flat."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, Vt

from tests.support.usd_stages import cloth_stage
from warpqem.usd import SimplifyOptions, simplify_stage

SIZE = 16


def bowl(mesh: UsdGeom.Mesh, depth: float) -> tuple[np.ndarray, np.ndarray]:
    """Bend a sheet to a shallow bowl, and give its corner points (N, 3, 3) and unit face normals (N, 3)."""
    points = np.array(mesh.GetPointsAttr().Get())
    points[:, 2] = depth * ((points[:, :2] - SIZE / 2) ** 2).sum(axis=1) / SIZE
    mesh.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(points))
    corners = points[np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)].astype(float)
    plane = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return corners, plane / np.linalg.norm(plane, axis=1, keepdims=True)


def author(mesh: UsdGeom.Mesh, name: str, normals: np.ndarray, interpolation: str) -> None:
    values = Vt.Vec3fArray.FromNumpy(normals.astype(np.float32))
    if name == "normals":
        mesh.CreateNormalsAttr(values)
        mesh.SetNormalsInterpolation(interpolation)
    else:
        kind = Sdf.ValueTypeNames.Normal3fArray
        UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("normals", kind, interpolation).Set(values)


def simplified(tmp_path, stage: Usd.Stage, ratio: float = 0.25) -> tuple[UsdGeom.Mesh, np.ndarray, np.ndarray]:
    """The mesh, its face normals (N', 3) and its authored normals at each corner (N', 3, 3)."""
    stage.GetRootLayer().Export(str(tmp_path / "in.usda"))
    simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(ratio=ratio))
    opened = Usd.Stage.Open(str(tmp_path / "out.usda"))
    mesh = UsdGeom.Mesh(opened.GetPrimAtPath("/Root/Cloth"))
    faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    corners = np.array(mesh.GetPointsAttr().Get())[faces].astype(float)
    plane = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    primvar = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("normals")
    if primvar.HasAuthoredValue():
        values, interpolation = np.array(primvar.ComputeFlattened()), primvar.GetInterpolation()
    else:
        values, interpolation = np.array(mesh.GetNormalsAttr().Get()), mesh.GetNormalsInterpolation()
    elements = {"uniform": np.repeat(np.arange(len(faces))[:, None], 3, axis=1), "vertex": faces}
    at_corners = values[elements.get(interpolation, np.arange(faces.size).reshape(-1, 3))]
    return opened, plane / np.linalg.norm(plane, axis=1, keepdims=True), at_corners


@pytest.mark.parametrize("name", ["normals", "primvars:normals"])
@pytest.mark.parametrize("interpolation", ["faceVarying", "uniform"])
@pytest.mark.parametrize("depth", [1.0, 0.1])
def test_flat_shading_of_any_angle_stays_flat(tmp_path, name, interpolation, depth):
    stage = cloth_stage(size=SIZE, times=None, triangles=True)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth"))
    _, normals = bowl(mesh, depth)
    author(mesh, name, normals if interpolation == "uniform" else np.repeat(normals, 3, axis=0), interpolation)
    _, plane, at_corners = simplified(tmp_path, stage)
    assert at_corners == pytest.approx(np.repeat(plane[:, None], 3, axis=1), abs=1e-5)


def test_flat_shading_by_points_of_single_faces_stays_flat(tmp_path):
    stage = cloth_stage(size=SIZE, times=None, triangles=True)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth"))
    corners, normals = bowl(mesh, 0.1)
    mesh.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(corners.reshape(-1, 3).astype(np.float32)))
    mesh.GetFaceVertexIndicesAttr().Set(Vt.IntArray.FromNumpy(np.arange(3 * len(normals), dtype=np.int32)))
    author(mesh, "normals", np.repeat(normals, 3, axis=0), "vertex")
    _, plane, at_corners = simplified(tmp_path, stage)
    assert at_corners == pytest.approx(np.repeat(plane[:, None], 3, axis=1), abs=1e-5)


def test_normals_against_the_winding_stay_so(tmp_path):
    stage = cloth_stage(size=SIZE, times=None, triangles=True)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth"))
    author(mesh, "normals", -np.repeat(bowl(mesh, 0.5)[1], 3, axis=0), "faceVarying")
    _, plane, at_corners = simplified(tmp_path, stage)
    assert at_corners == pytest.approx(-np.repeat(plane[:, None], 3, axis=1), abs=1e-5)


def test_smooth_normals_stay_smooth(tmp_path):
    stage = cloth_stage(size=SIZE, times=None, triangles=True)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth"))
    corners, _ = bowl(mesh, 0.5)
    smooth = np.concatenate([-(corners[..., :2] - SIZE / 2) / SIZE, np.ones((*corners.shape[:2], 1))], axis=2)
    smooth /= np.linalg.norm(smooth, axis=2, keepdims=True)
    author(mesh, "normals", smooth.reshape(-1, 3), "faceVarying")
    opened, plane, at_corners = simplified(tmp_path, stage)
    faces = np.array(opened.GetPrimAtPath("/Root/Cloth").GetAttribute("faceVertexIndices").Get())
    by_vertex = {vertex: at_corners.reshape(-1, 3)[faces == vertex] for vertex in np.unique(faces)}
    assert all(np.ptp(normals, axis=0).max() < 1e-6 for normals in by_vertex.values())
    assert np.abs(at_corners - plane[:, None]).max() > 1e-2


def test_bent_normals_of_single_faces_are_left_to_their_maker(tmp_path):
    """Normals that are those of no face are values like others."""
    stage = cloth_stage(size=SIZE, times=None, triangles=True)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth"))
    bowl(mesh, 0.1)
    rng = np.random.default_rng(2)
    bent = rng.normal(size=(2 * SIZE * SIZE, 3)) * [1, 1, 0]
    author(mesh, "normals", bent / np.linalg.norm(bent, axis=1, keepdims=True), "uniform")
    _, _, at_corners = simplified(tmp_path, stage)
    assert np.abs(at_corners[..., 2]).max() < 1e-6
