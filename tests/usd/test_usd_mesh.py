"""Reading a mesh with all its poses."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom

from tests.support.usd_stages import FRAMES, cloth_stage, quad_grid, waves
from warpqem.errors import StageError
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.skeleton_poses import StagePoses
from warpqem.usd.read.time_codes import FrameRange


def source_of(stage: Usd.Stage, path: str = "/Root/Cloth") -> MeshSource:
    return MeshSource(stage.GetPrimAtPath(path), StagePoses(stage))


def points_of(stage: Usd.Stage) -> Usd.Attribute:
    return UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth")).GetPointsAttr()


def test_every_point_sample_is_a_frame():
    source = source_of(cloth_stage())
    mesh = source.read(source.frame_times())
    assert mesh.times == FRAMES
    np.testing.assert_array_equal(mesh.points, waves(quad_grid(8)[0], 3))


def test_still_mesh_is_one_frame_at_the_default_time():
    source = source_of(cloth_stage(times=None))
    mesh = source.read(source.frame_times())
    assert mesh.times is None
    assert mesh.points.shape == (1, 81, 3)


def test_quads_are_cut_into_triangles():
    source = source_of(cloth_stage())
    assert source.read(None if not source.authored_times else FRAMES).faces.shape == (128, 3)


def test_points_that_no_face_uses_are_left_out():
    stage = cloth_stage(times=None)
    points = list(points_of(stage).Get())
    points_of(stage).Set([Gf.Vec3f(9, 9, 9), *points])
    indices = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth")).GetFaceVertexIndicesAttr()
    indices.Set([index + 1 for index in indices.Get()])
    mesh = source_of(stage).read(None)
    assert mesh.used_points.tolist() == list(range(1, 82))
    np.testing.assert_array_equal(mesh.points[0], points)
    assert mesh.faces.min() == 0


def test_frame_range_without_a_sample_inside_is_refused():
    with pytest.raises(StageError, match=r"/Root/Cloth\.points: no sample between the times 2\.5 and 3"):
        source_of(cloth_stage()).frame_times(FrameRange(2.5, 3))


def test_frame_range_with_a_step_interpolates():
    source = source_of(cloth_stage())
    times = source.frame_times(FrameRange(2, 4, 1))
    poses = waves(quad_grid(8)[0], 3)
    np.testing.assert_allclose(source.read(times).points[1], (poses[1] + poses[2]) / 2, atol=1e-6)


def test_left_handed_faces_are_turned_for_measuring_only():
    stage = cloth_stage()
    UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth")).CreateOrientationAttr("leftHanded")
    mesh = source_of(stage).read(FRAMES)
    assert mesh.faces[0].tolist() == [0, 1, 10]
    assert mesh.right_handed_faces[0].tolist() == [10, 1, 0]


def test_blocked_sample_names_attribute_and_time():
    stage = cloth_stage()
    points_of(stage).Set(Sdf.ValueBlock(), 2.0)
    source = source_of(stage)
    with pytest.raises(StageError, match=r"/Root/Cloth\.points: no value at time 2 "):
        source.read(source.frame_times())


def test_point_that_is_not_a_number_names_point_and_time():
    stage = cloth_stage()
    points = np.array(points_of(stage).Get(2.0))
    points[7, 1] = np.nan
    points_of(stage).Set(points, 2.0)
    source = source_of(stage)
    with pytest.raises(StageError, match=r"point 7 at time 2 is \[.*nan"):
        source.read(source.frame_times())


def test_point_count_that_changes_names_the_time():
    stage = cloth_stage()
    points_of(stage).Set([*points_of(stage).Get(4.0), Gf.Vec3f(0)], 4.0)
    source = source_of(stage)
    with pytest.raises(StageError, match="82 points at time 4, 81 before"):
        source.read(source.frame_times())


def test_mesh_without_points_is_refused():
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.Mesh.Define(stage, "/Mesh")
    with pytest.raises(StageError, match=r"/Mesh\.points: no value at time default"):
        source_of(stage, "/Mesh")
