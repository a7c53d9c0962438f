"""Reading polygons."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pxr import Sdf, Usd, UsdGeom

from tests.support.usd_stages import cloth_stage
from warpqem.errors import StageError
from warpqem.usd.read.triangulation import fan_triangulate, read_topology


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


def test_cuts_of_quads_do_not_fall_on_edges_of_others():
    # The edge 2-3 of both, 3-0 of both, and cut from their first corners, 0-2 of both.
    _stage, mesh = make_mesh([4, 4], [0, 1, 2, 3, 0, 3, 2, 4])
    topology = read_topology(mesh, 5)
    ends = np.sort(
        np.stack([topology.triangles, np.roll(topology.triangles, -1, axis=1)], axis=2).reshape(-1, 2), axis=1
    )
    _, counts = np.unique(ends, axis=0, return_counts=True)
    assert counts.max() == 2
    assert sorted(topology.triangle_polygons) == [0, 0, 1, 1]


@given(st.lists(st.integers(3, 7), min_size=1, max_size=6), st.data())
def test_triangles_cover_every_polygon_from_any_corner(sizes, data):
    counts = np.array(sizes, dtype=np.int32)
    apexes = np.array([data.draw(st.integers(0, size - 1)) for size in sizes])
    corners, polygons = fan_triangulate(counts, apexes)
    assert np.bincount(polygons).tolist() == (counts - 2).tolist()
    first = np.cumsum(counts) - counts
    for polygon, size in enumerate(sizes):
        local = corners[polygons == polygon] - first[polygon]
        assert set(local.ravel()) == set(range(size))
        # Signed areas on a convex polygon add up to its own, so that nothing is covered twice or turned over.
        angle = 2 * np.pi * np.arange(size) / size
        x, y = np.cos(angle)[local], np.sin(angle)[local]
        areas = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
        assert (areas > 0).all()
        assert areas.sum() / 2 == pytest.approx(size * np.sin(2 * np.pi / size) / 2)
