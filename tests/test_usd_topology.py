"""Reading polygons."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom
from test_usd_stages import cloth_stage

from warpqem.errors import StageError
from warpqem.usd.topology import fan_triangulate, read_topology


def make_mesh(counts: list[int], indices: list[int]) -> tuple[Usd.Stage, UsdGeom.Mesh]:
    stage = Usd.Stage.CreateInMemory()
    mesh = UsdGeom.Mesh.Define(stage, "/Mesh")
    mesh.CreateFaceVertexCountsAttr(counts)
    mesh.CreateFaceVertexIndicesAttr(indices)
    return stage, mesh


def test_fan_shares_the_first_corner_and_keeps_the_winding():
    triangles, polygons = fan_triangulate(np.array([3, 5]))
    assert triangles.tolist() == [[0, 1, 2], [3, 4, 5], [3, 5, 6], [3, 6, 7]]
    assert polygons.tolist() == [0, 1, 1, 1]


def test_polygons_below_three_corners_give_no_triangle():
    triangles, polygons = fan_triangulate(np.array([2, 0, 3, 1]))
    assert triangles.tolist() == [[2, 3, 4]]
    assert polygons.tolist() == [2]


def test_holes_are_left_out():
    _stage, mesh = make_mesh([3, 3], [0, 1, 2, 1, 2, 3])
    mesh.CreateHoleIndicesAttr([0])
    topology = read_topology(mesh, 4)
    assert topology.triangles.tolist() == [[1, 2, 3]]
    assert topology.hole_count == 1


def test_triangles_that_name_a_point_twice_are_left_out():
    _stage, mesh = make_mesh([3, 3], [0, 1, 1, 1, 2, 3])
    topology = read_topology(mesh, 4)
    assert topology.triangles.tolist() == [[1, 2, 3]]
    assert topology.degenerate_count == 1


def test_index_out_of_range_names_prim_face_and_value():
    _stage, mesh = make_mesh([3, 3], [0, 1, 2, 1, 2, 9])
    with pytest.raises(StageError, match=r"/Mesh\.faceVertexIndices: face 1 refers to point 9.*4 points"):
        read_topology(mesh, 4)


def test_counts_that_do_not_sum_to_the_indices_are_refused():
    _stage, mesh = make_mesh([3, 4], [0, 1, 2, 1, 2, 3])
    with pytest.raises(StageError, match=r"/Mesh\.faceVertexCounts: .*7.*6"):
        read_topology(mesh, 4)


def test_negative_count_is_refused():
    _stage, mesh = make_mesh([3, -3, 3], [0, 1, 2])
    with pytest.raises(StageError, match=r"face 1 has -3 corners"):
        read_topology(mesh, 4)


def test_hole_that_is_no_face_is_refused():
    _stage, mesh = make_mesh([3], [0, 1, 2])
    mesh.CreateHoleIndicesAttr([5])
    with pytest.raises(StageError, match="holeIndices: face 5"):
        read_topology(mesh, 3)


def test_topology_that_changes_over_time_names_the_time():
    stage = cloth_stage()
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth"))
    indices = mesh.GetFaceVertexIndicesAttr()
    value = list(indices.Get())
    indices.Set(value, 1.0)
    indices.Set(value, 2.0)
    indices.Set(value[1:] + value[:1], 3.0)
    with pytest.raises(StageError, match=r"/Root/Cloth\.faceVertexIndices: changes at time 3"):
        read_topology(mesh, 81)


def test_equal_samples_of_the_topology_are_accepted():
    stage = cloth_stage()
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth"))
    for time in (1.0, 2.0):
        mesh.GetFaceVertexIndicesAttr().Set(mesh.GetFaceVertexIndicesAttr().Get(), time)
    assert len(read_topology(mesh, 81).triangles) == 128


def test_blocked_sample_of_the_topology_names_the_time():
    stage = cloth_stage()
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth"))
    indices = mesh.GetFaceVertexIndicesAttr()
    indices.Set(indices.Get(), 1.0)
    indices.Set(Sdf.ValueBlock(), 2.0)
    with pytest.raises(StageError, match="time 2"):
        read_topology(mesh, 81)
