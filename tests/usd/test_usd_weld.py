"""Joining points that lie together."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from tests.support.usd_stages import cloth_stage, skinned_stage
from warpqem.measure import topology
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.read.weld import weld

CLOTH = "/Root/Cloth"
QUADS = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)


def strip(*columns: float) -> np.ndarray:
    """Points of quads next to each other, four for each: columns[i] to columns[i + 1]."""
    pairs = itertools.pairwise(columns)
    return np.concatenate([[(a, 0, 0), (b, 0, 0), (b, 1, 0), (a, 1, 0)] for a, b in pairs]).astype(np.float32)


def test_coinciding_borders_are_sewn():
    faces = np.concatenate([QUADS, QUADS + 4])
    assert weld(faces, [strip(0, 1, 2)]).tolist() == [0, 1, 2, 3, 1, 5, 6, 2]


def test_borders_apart_in_one_frame_stay_apart():
    faces = np.concatenate([QUADS, QUADS + 4])
    second = strip(0, 1, 2)
    second[4:] += np.float32(1e-6)
    assert weld(faces, [strip(0, 1, 2), second]).tolist() == list(range(8))


def test_third_sheet_on_an_edge_stays_apart():
    faces = np.concatenate([QUADS, QUADS + 4, QUADS + 8])
    points = np.concatenate([strip(0, 1, 2), strip(1, 2) + np.array([0, 0, 1], dtype=np.float32)])
    points[[8, 11], 2] = 0
    assert weld(faces, [points]).tolist() == list(range(12))


def test_parts_that_touch_at_a_point_stay_apart():
    points = np.concatenate([strip(0, 1), strip(1, 2) + np.array([0, 1, 0], dtype=np.float32)])
    assert weld(np.concatenate([QUADS, QUADS + 4]), [points]).tolist() == list(range(8))


def test_sheets_that_face_apart_stay_apart():
    faces = np.concatenate([QUADS, (QUADS + 4)[:, ::-1]])
    assert weld(faces, [strip(0, 1, 2)]).tolist() == list(range(8))


def test_face_is_not_flattened():
    faces = np.array([[0, 1, 2]], dtype=np.int32)
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 0]], dtype=np.float32)
    assert weld(faces, [points]).tolist() == [0, 1, 2]


def cracked() -> tuple[np.ndarray, np.ndarray]:
    """Two quads with points of their own on x = 1, and between them two faces without area that fill the crack."""
    faces = np.concatenate([QUADS, QUADS + 4, [[1, 4, 2], [4, 7, 2]]]).astype(np.int32)
    return strip(0, 1, 2), faces


def test_crack_filled_with_slivers_is_sewn_and_the_slivers_close():
    points, faces = cracked()
    joined = weld(faces, [points])
    assert joined.tolist() == [0, 1, 2, 3, 1, 5, 6, 2]
    assert [len(set(face)) for face in joined[faces].tolist()] == [3, 3, 3, 3, 2, 2]


def test_slivers_that_open_in_one_frame_stay_faces():
    points, faces = cracked()
    opened = points + np.repeat([[0, 0, 0], [0.5, 0, 0]], 4, axis=0).astype(np.float32)
    assert weld(faces, [points, opened]).tolist() == list(range(8))


def test_slivers_on_an_edge_of_three_sheets_stay_faces():
    points, faces = cracked()
    faces = np.concatenate([faces, QUADS + 8]).astype(np.int32)
    third = strip(1, 2) + np.array([0, 0, 1], dtype=np.float32)
    third[[0, 3], 2] = 0
    assert weld(faces, [np.concatenate([points, third])]).tolist() == list(range(12))


def test_closed_surface_is_left_alone():
    faces = np.array([[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]], dtype=np.int32)
    assert weld(faces, [np.zeros((4, 3), dtype=np.float32)]).tolist() == [0, 1, 2, 3]


def split_cloth(folder: Path, shift: float = 0.0) -> Usd.Stage:
    """A cloth whose right half has points of its own, on the line x = 4 too, with texture coordinates for each."""
    stage = cloth_stage(folder / "in.usda")
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH))
    quads = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 4)
    right = quads.min(axis=1) % 9 >= 4
    split, corners = np.unique(quads + 81 * right[:, None], return_inverse=True)
    mesh.GetFaceVertexIndicesAttr().Set(Vt.IntArray.FromNumpy(corners.astype(np.int32).ravel()))
    for time in mesh.GetPointsAttr().GetTimeSamples():
        points = np.array(mesh.GetPointsAttr().Get(time))[split % 81]
        points[split >= 81, 2] += np.float32(shift)
        mesh.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(points), time)
    primvars = UsdGeom.PrimvarsAPI(mesh)
    primvars.CreatePrimvar("island", Sdf.ValueTypeNames.FloatArray, "vertex").Set((100.0 * (split >= 81)).tolist())
    primvars.CreatePrimvar("x", Sdf.ValueTypeNames.FloatArray, "vertex").Set((split % 81 % 9).astype(float).tolist())
    stage.Save()
    return stage


def simplified(folder: Path, **options: object) -> UsdGeom.Mesh:
    given = SimplifyOptions(**{"ratio": 0.3, "device": "cpu", **options})
    report = simplify_stage(folder / "in.usda", folder / "out.usda", given)
    assert [(prim.status, prim.dropped) for prim in report.prims] == [("simplified", [])]
    stage = Usd.Stage.Open(str(folder / "out.usda"))
    stages.append(stage)
    return UsdGeom.Mesh(stage.GetPrimAtPath(report.prims[0].path))


# A mesh does not keep its stage alive.
stages: list[Usd.Stage] = []


def part_count(mesh: UsdGeom.Mesh) -> int:
    faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    return topology(faces).components


@pytest.mark.parametrize(("options", "parts"), [({}, 1), ({"weld": False}, 2)])
def test_split_points_become_one_surface_unless_told_otherwise(tmp_path, options, parts):
    split_cloth(tmp_path)
    assert part_count(simplified(tmp_path, **options)) == parts


def test_parts_that_do_not_lie_together_stay_parts(tmp_path):
    split_cloth(tmp_path, shift=0.01)
    assert part_count(simplified(tmp_path)) == 2


def test_point_values_that_differ_between_welded_points_stay_apart(tmp_path):
    split_cloth(tmp_path)
    mesh = simplified(tmp_path)
    island = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("island")
    faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    x = np.array(mesh.GetPointsAttr().Get(1.0))[faces][:, :, 0].mean(axis=1)
    assert island.GetInterpolation() == "faceVarying"
    np.testing.assert_array_equal(island.ComputeFlattened(), np.repeat(100.0 * (x > 4), 3))


def test_point_values_that_agree_stay_point_values(tmp_path):
    split_cloth(tmp_path)
    mesh = simplified(tmp_path)
    values = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("x")
    assert values.GetInterpolation() == "vertex"
    assert len(values.Get()) == len(mesh.GetPointsAttr().Get(1.0))


def test_point_normals_across_a_hard_edge_become_corner_normals(tmp_path):
    stage = split_cloth(tmp_path)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH))
    island = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("island").Get()
    mesh.CreateNormalsAttr([Gf.Vec3f(1, 0, 0) if value else Gf.Vec3f(0, 0, 1) for value in island])
    stage.Save()
    result = simplified(tmp_path)
    normals = np.array(result.GetNormalsAttr().Get())
    assert result.GetNormalsInterpolation() == "faceVarying"
    assert len(normals) == len(result.GetFaceVertexIndicesAttr().Get())
    assert set(map(tuple, normals.tolist())) == {(1, 0, 0), (0, 0, 1)}


def crack_filled(folder: Path) -> None:
    """Fill the crack of `split_cloth` with quads that have no area."""
    stage = split_cloth(folder)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH))
    quads = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 4)
    points = np.array(mesh.GetPointsAttr().Get(1.0))
    left, right = (side[np.argsort(points[side, 1])] for side in _sides_of_crack(quads, points))
    filling = np.stack([left[:-1], right[:-1], right[1:], left[1:]], axis=1)
    corners = np.concatenate([quads, filling]).astype(np.int32)
    mesh.GetFaceVertexIndicesAttr().Set(Vt.IntArray.FromNumpy(corners.ravel()))
    mesh.GetFaceVertexCountsAttr().Set([4] * len(corners))
    stage.Save()


def _sides_of_crack(quads: np.ndarray, points: np.ndarray) -> list[np.ndarray]:
    """The points on x = 4 of the quads on its left and on its right."""
    left = points[quads][:, :, 0].mean(axis=1) < 4
    return [np.unique(side[points[side][:, 0] == 4]) for side in (quads[left].ravel(), quads[~left].ravel())]


def test_faces_without_area_do_not_keep_split_points_apart(tmp_path):
    crack_filled(tmp_path)
    assert part_count(simplified(tmp_path)) == 1


def test_point_values_stay_apart_across_faces_without_area(tmp_path):
    crack_filled(tmp_path)
    mesh = simplified(tmp_path)
    faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    x = np.array(mesh.GetPointsAttr().Get(1.0))[faces][:, :, 0].mean(axis=1)
    island = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("island").ComputeFlattened()
    np.testing.assert_array_equal(island, np.repeat(100.0 * (x > 4), 3))


def test_points_of_different_joints_stay_apart(tmp_path):
    stage = skinned_stage(tmp_path / "in.usda")
    prim = stage.GetPrimAtPath("/Char/Body")
    mesh, binding = UsdGeom.Mesh(prim), UsdSkel.BindingAPI(prim)
    quads = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 4)
    split, corners = np.unique(quads + 81 * (quads.min(axis=1) % 9 >= 4)[:, None], return_inverse=True)
    mesh.GetFaceVertexIndicesAttr().Set(Vt.IntArray.FromNumpy(corners.astype(np.int32).ravel()))
    mesh.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(np.array(mesh.GetPointsAttr().Get())[split % 81]))
    binding.GetJointIndicesPrimvar().Set([0, 1] * len(split))
    # In these poses the two halves tear open, whatever the rest shape.
    weights = np.where(split[:, None] >= 81, [[0.0, 1.0]], [[1.0, 0.0]]).astype(np.float32)
    binding.GetJointWeightsPrimvar().Set(Vt.FloatArray.FromNumpy(weights.ravel()))
    stage.Save()
    assert part_count(simplified(tmp_path)) == 2
