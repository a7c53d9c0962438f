"""Finding seams."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, Vt

from tests.support.rich_stage import CLOTH
from tests.support.usd_stages import cloth_stage
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.read.mesh_seams import MeshSeams, find_seams
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.skeleton_poses import StagePoses

SIZE = 4
CORNERS = 4 * SIZE * SIZE


@pytest.fixture
def stage() -> Usd.Stage:
    """A still grid of 4 x 4 quads on 5 x 5 points."""
    return cloth_stage(size=SIZE, times=None)


def cloth(stage: Usd.Stage) -> UsdGeom.Mesh:
    return UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth"))


def seams_of(stage: Usd.Stage) -> MeshSeams:
    source = MeshSource(cloth(stage).GetPrim(), StagePoses(stage))
    return find_seams(source, source.topology.triangles)


def corner_primvar(stage: Usd.Stage, name: str, kind: Sdf.ValueTypeName) -> UsdGeom.Primvar:
    return UsdGeom.PrimvarsAPI(cloth(stage)).CreatePrimvar(name, kind, "faceVarying")


def in_right_half() -> np.ndarray:
    """For each corner, whether its quad lies right of the middle."""
    return np.repeat(np.arange(SIZE * SIZE) % SIZE >= SIZE // 2, 4)


MIDDLE_LINE = [[2, 7], [7, 12], [12, 17], [17, 22]]


def test_edges_where_values_differ_are_seams(stage):
    corner_primvar(stage, "st", Sdf.ValueTypeNames.FloatArray).Set(in_right_half().astype(float).tolist())
    assert seams_of(stage).by_name["primvars:st"].tolist() == MIDDLE_LINE


def test_edges_where_only_the_index_differs_are_none(stage):
    primvar = corner_primvar(stage, "st", Sdf.ValueTypeNames.FloatArray)
    primvar.Set([5.0, 5.0])
    primvar.SetIndices(in_right_half().astype(int).tolist())
    assert len(seams_of(stage).by_name["primvars:st"]) == 0


@pytest.mark.parametrize(("step", "expected"), [(1e-7, []), (1e-5, MIDDLE_LINE)])
def test_edges_where_values_differ_by_rounding_are_none(stage, step, expected):
    values = np.ones(CORNERS) + step * in_right_half()
    # What is infinite is as far from itself as from nothing.
    values[0] = np.inf
    corner_primvar(stage, "st", Sdf.ValueTypeNames.FloatArray).Set(values.tolist())
    found = seams_of(stage).by_name["primvars:st"].tolist()
    assert [pair for pair in found if pair in MIDDLE_LINE] == expected


def test_edges_inside_a_polygon_are_none(stage):
    corner_primvar(stage, "id", Sdf.ValueTypeNames.IntArray).Set(np.repeat(np.arange(SIZE * SIZE), 4).tolist())
    points = np.array(cloth(stage).GetPointsAttr().Get())
    ends = points[seams_of(stage).by_name["primvars:id"]]
    assert len(ends) == 2 * SIZE * (SIZE - 1)
    assert (np.abs(ends[:, 0, :2] - ends[:, 1, :2]).sum(axis=1) == 1).all()


def test_seam_at_one_time_is_a_seam(stage):
    primvar = corner_primvar(stage, "st", Sdf.ValueTypeNames.FloatArray)
    primvar.Set([0.0] * CORNERS, 1.0)
    primvar.Set(in_right_half().astype(float).tolist(), 2.0)
    assert seams_of(stage).by_name["primvars:st"].tolist() == MIDDLE_LINE


def test_strings_make_seams(stage):
    corner_primvar(stage, "tag", Sdf.ValueTypeNames.StringArray).Set([str(half) for half in in_right_half()])
    assert seams_of(stage).by_name["primvars:tag"].tolist() == MIDDLE_LINE


@pytest.mark.parametrize(("degrees", "expected"), [(5, []), (60, MIDDLE_LINE)])
def test_normals_make_seams_at_hard_edges_only(stage, degrees, expected):
    tilted = Gf.Vec3f(float(np.sin(np.radians(degrees))), 0, float(np.cos(np.radians(degrees))))
    cloth(stage).CreateNormalsAttr([tilted if half else Gf.Vec3f(0, 0, 1) for half in in_right_half()])
    cloth(stage).SetNormalsInterpolation("faceVarying")
    assert seams_of(stage).by_name["normals"].tolist() == expected


def test_border_between_subsets_is_a_seam(stage):
    right = np.flatnonzero(in_right_half()[::4]).tolist()
    UsdGeom.Subset.CreateGeomSubset(cloth(stage), "right", "face", right, "materialBind", "nonOverlapping")
    assert seams_of(stage).borders.tolist() == MIDDLE_LINE


def test_crease_is_a_seam(stage):
    cloth(stage).CreateCreaseIndicesAttr([2, 7, 12])
    cloth(stage).CreateCreaseLengthsAttr([3])
    cloth(stage).CreateCreaseSharpnessesAttr([2.0])
    assert seams_of(stage).borders.tolist() == [[2, 7], [7, 12]]


def test_values_of_single_faces_are_not_held_closed(stage):
    corner_primvar(stage, "id", Sdf.ValueTypeNames.IntArray).Set(np.repeat(np.arange(SIZE * SIZE), 4).tolist())
    seams, faces = seams_of(stage), np.zeros((0, 3), dtype=np.int32)
    assert len(seams.hold()) == 0
    assert seams.released(faces, np.zeros(0, dtype=np.int32)) == ["closed seams of primvars:id (too many)"]


def test_islands_without_a_face_left_are_named(stage):
    corner_primvar(stage, "st", Sdf.ValueTypeNames.FloatArray).Set(in_right_half().astype(float).tolist())
    source = MeshSource(cloth(stage).GetPrim(), StagePoses(stage))
    faces = source.topology.triangles
    left = np.flatnonzero(source.topology.triangle_polygons % SIZE < SIZE // 2).astype(np.int32)
    seams = find_seams(source, faces)
    assert seams.released(faces, left) == ["1 of 2 islands of primvars:st"]
    assert seams.released(faces, np.arange(len(faces), dtype=np.int32)) == []


def test_mesh_of_one_face_has_no_seams():
    stage = Usd.Stage.CreateInMemory()
    mesh = UsdGeom.Mesh.Define(stage, "/Root/Cloth")
    mesh.CreatePointsAttr([(0, 0, 0), (1, 0, 0), (0, 1, 0)])
    mesh.CreateFaceVertexCountsAttr([3])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2])
    primvars = UsdGeom.PrimvarsAPI(mesh)
    primvars.CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, "faceVarying").Set([(0, 0), (1, 0), (0, 1)])
    mesh.CreateDisplayColorPrimvar("uniform").Set([(1, 0, 0)])
    assert len(seams_of(stage).by_name.get("primvars:st", ())) == 0


@pytest.mark.parametrize("element_size", [1, 2, 3])
def test_normals_of_faces_may_have_several_elements(element_size, tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH))
    count = element_size * len(mesh.GetFaceVertexCountsAttr().Get())
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
        "facing", Sdf.ValueTypeNames.Normal3fArray, "uniform", element_size
    )
    primvar.Set(Vt.Vec3fArray([(0, 0, 1)] * count))
    stage.Save()
    options = SimplifyOptions(ratio=0.5, device="cpu")
    [prim] = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options).prims
    assert prim.status == "simplified"
    result = Usd.Stage.Open(str(tmp_path / "out.usda"))
    after = UsdGeom.PrimvarsAPI(result.GetPrimAtPath(CLOTH)).GetPrimvar("facing")
    assert len(after.Get()) == element_size * prim.faces_after
