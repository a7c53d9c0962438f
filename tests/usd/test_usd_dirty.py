"""Files with broken or odd topology."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, Vt

from tests.support.usd_checks import check_stage, compare_properties
from tests.support.usd_stages import cloth_stage, define_cloth, quad_grid, waves
from warpqem.errors import StageError
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.read.inspect import inspect_stage

POINTS, _, INDICES = quad_grid(6)
FACES = INDICES.reshape(-1, 4)[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3).tolist()
FLAW = "/Root/Cloth"
VARYING = "/Root/Varying"


def second_sheet() -> tuple[np.ndarray, list[list[int]]]:
    """A copy of the grid above it, for flaws between two parts."""
    return np.concatenate([POINTS, POINTS + np.float32([0, 0, 2])]), [*FACES, *(np.array(FACES) + len(POINTS)).tolist()]


def flaws() -> dict[str, tuple[np.ndarray, list[list[int]]]]:
    """Points and faces of triangle meshes with one flaw each."""
    two_points, two_faces = second_sheet()
    fin = np.concatenate([POINTS, [[2.5, 2.5, 3]]])
    joined = [[24 if index == 24 + len(POINTS) else index for index in face] for face in two_faces]
    turned = [face[::-1] if number % 5 == 0 else face for number, face in enumerate(FACES)]
    return {
        "edge with three faces": (fin, [*FACES, [16, 17, 49]]),
        "two sheets in one vertex": (two_points, joined),
        "bow tie": (np.concatenate([POINTS, [[3, -1, 0], [4, -1, 0]]]), [*FACES, [3, 49, 50]]),
        "duplicate faces": (POINTS, [*FACES, *FACES[10:14]]),
        "faces twice, turned over": (POINTS, [*FACES, *[face[::-1] for face in FACES[10:14]]]),
        "faces that name a vertex twice": (POINTS, [*FACES, [8, 8, 9], [3, 3, 3]]),
        "faces without area": (POINTS, [*FACES, [7, 8, 9], [21, 22, 23]]),
        "unreferenced points": (np.concatenate([np.full((3, 3), 1e6), POINTS]), (np.array(FACES) + 3).tolist()),
        "faces the wrong way round": (POINTS, turned),
        "points in the same place": (np.where(np.arange(49)[:, None] == 9, POINTS[8], POINTS), FACES),
    }


def write(path: Path, points: np.ndarray, faces: list[list[int]], moving: bool) -> Usd.Stage:
    stage = cloth_stage(path)
    stage.RemovePrim(FLAW)
    mesh = UsdGeom.Mesh.Define(stage, FLAW)
    mesh.CreateSubdivisionSchemeAttr("none")
    mesh.CreateFaceVertexCountsAttr([len(face) for face in faces])
    mesh.CreateFaceVertexIndicesAttr(np.array(faces).ravel().tolist())
    poses = waves(np.asarray(points, dtype=np.float32), 2)
    for time, pose in enumerate(poses if moving else poses[:1]):
        code = Usd.TimeCode(float(time)) if moving else Usd.TimeCode.Default()
        mesh.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(pose), code)
    uv = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, "faceVarying")
    corners = np.asarray(points, dtype=np.float32)[np.array(faces).ravel(), :2]
    uv.Set(Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(corners)))
    stage.Save()
    return stage


@pytest.mark.parametrize("moving", [False, True], ids=["still", "moving"])
@pytest.mark.parametrize("flaw", flaws())
def test_flawed_mesh_is_simplified(flaw, moving, tmp_path, flatten):
    write(tmp_path / "in.usda", *flaws()[flaw], moving)
    # A fin that lies on the sheet and faces without area are the first that may go.
    options = SimplifyOptions(ratio=0.5, keep_components=True, device="cpu", flatten=flatten)
    [prim] = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options).prims
    lost = [line for line in prim.dropped if "no face uses" not in line]
    assert (prim.status, lost) == ("simplified", [])
    assert prim.faces_after < prim.faces_before
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    check_stage(stage, Usd.Stage.Open(str(tmp_path / "in.usda")))
    points = np.array(UsdGeom.Mesh(stage.GetPrimAtPath(FLAW)).GetPointsAttr().Get(Usd.TimeCode.EarliestTime()))
    # Nothing flies off, and points that no face uses do not come along.
    assert points.min() > -3
    assert points.max() < 9


def varying_stage(path: Path) -> None:
    """A cloth, and one whose faces and points change at time 2."""
    stage = cloth_stage(path)
    mesh = UsdGeom.Mesh.Define(stage, VARYING)
    mesh.CreateSubdivisionSchemeAttr("none")
    for time, size in ((1.0, 3), (2.0, 4)):
        points, counts, indices = quad_grid(size)
        mesh.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(points), time)
        mesh.CreateFaceVertexCountsAttr().Set(Vt.IntArray.FromNumpy(counts), time)
        mesh.CreateFaceVertexIndicesAttr().Set(Vt.IntArray.FromNumpy(indices), time)
    stage.Save()


def test_mesh_of_varying_topology_comes_through_as_it_is(tmp_path, flatten):
    varying_stage(tmp_path / "in.usda")
    options = SimplifyOptions(ratio=0.5, device="cpu", varying_topology="refuse", flatten=flatten)
    report = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options)
    [failed] = report.failed
    assert failed.path == VARYING
    assert failed.message == (
        f"{VARYING}.faceVertexCounts: changes at time 2; a mesh whose topology varies over time cannot be simplified"
    )
    stages = [Usd.Stage.Open(str(tmp_path / name)) for name in ("in.usda", "out.usda")]
    assert {path.split(".")[0] for path in compare_properties(*stages)} == {FLAW}


def test_mesh_of_varying_topology_comes_through_on_every_level(tmp_path):
    varying_stage(tmp_path / "in.usda")
    simplify_stage(
        tmp_path / "in.usda",
        tmp_path / "out.usda",
        SimplifyOptions(lods=(0.5, 0.2), device="cpu", varying_topology="refuse"),
    )
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    for level in range(3):
        stage.GetDefaultPrim().GetVariantSet("LOD").SetVariantSelection(f"LOD{level}")
        counts = UsdGeom.Mesh(stage.GetPrimAtPath(VARYING)).GetFaceVertexCountsAttr()
        assert [len(counts.Get(time)) for time in (1.0, 2.0)] == [9, 16]


def test_strict_refuses_varying_topology_and_writes_nothing(tmp_path):
    varying_stage(tmp_path / "in.usda")
    options = SimplifyOptions(ratio=0.5, device="cpu", varying_topology="refuse", strict=True)
    with pytest.raises(StageError, match=rf"{VARYING}\.faceVertexCounts: changes at time 2"):
        simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options)
    assert not (tmp_path / "out.usda").exists()


def test_points_that_change_in_number_under_the_same_faces_are_named(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    define_cloth(stage, VARYING, times=[1.0, 2.0])
    attribute = UsdGeom.Mesh(stage.GetPrimAtPath(VARYING)).GetPointsAttr()
    attribute.Set([*attribute.Get(2.0), (0, 0, 0)], 2.0)
    stage.Save()
    options = SimplifyOptions(ratio=0.5, device="cpu", varying_topology="refuse")
    [failed] = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options).failed
    assert str(failed.message).startswith(f"{VARYING}.points: 82 points at time 2, 81 before")


def both_sides(path: Path) -> None:
    """A grid whose faces are there twice, the second time turned over, with colours, UVs and a subset of each side."""
    stage = cloth_stage(path)
    stage.RemovePrim(FLAW)
    mesh = UsdGeom.Mesh.Define(stage, FLAW)
    mesh.CreateSubdivisionSchemeAttr("none")
    faces = np.array([*FACES, *[face[::-1] for face in FACES]])
    count = len(FACES)
    mesh.CreateFaceVertexCountsAttr([3] * len(faces))
    mesh.CreateFaceVertexIndicesAttr(faces.ravel().tolist())
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(waves(POINTS, 1)[0]))
    primvars = UsdGeom.PrimvarsAPI(mesh)
    colours = np.repeat(np.float32([[1, 0, 0], [0, 0, 1]]), count, axis=0)
    primvars.CreatePrimvar("displayColor", Sdf.ValueTypeNames.Color3fArray, "uniform").Set(colours)
    sides = np.repeat(np.float32([0, 10]), 3 * count)
    corners = POINTS[faces.ravel(), :2] + sides[:, None]
    primvars.CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, "faceVarying").Set(
        Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(corners, dtype=np.float32))
    )
    UsdGeom.Subset.CreateGeomSubset(mesh, "Back", "face", list(range(count, 2 * count)))
    stage.Save()


@pytest.mark.parametrize("options", [{"ratio": 0.3}, {"faces": 40}, {"lods": (0.3,)}])
def test_each_side_of_a_double_sheet_keeps_its_own_values(options, tmp_path):
    both_sides(tmp_path / "in.usda")
    report = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(device="cpu", **options))
    [prim] = report.prims
    assert f"{FLAW}: faces on the back of another, kept as its other side: 72" in prim.problems
    assert prim.faces_after <= options.get("faces", 43)
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    if "lods" in options:
        stage.GetDefaultPrim().GetVariantSet("LOD").SetVariantSelection("LOD1")
    check_stage(stage)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(FLAW))
    points = np.array(mesh.GetPointsAttr().Get())
    faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    a, b, c = (points[faces[:, k]] for k in range(3))
    up = np.cross(b - a, c - a)[:, 2] > 0
    assert up.sum() == len(faces) // 2
    primvars = UsdGeom.PrimvarsAPI(mesh)
    assert (np.array(primvars.GetPrimvar("displayColor").ComputeFlattened())[:, 0] == up).all()
    uv = np.array(primvars.GetPrimvar("st").ComputeFlattened()).reshape(-1, 3, 2)
    np.testing.assert_allclose(uv - np.where(up, 0, 10)[:, None, None], points[faces][..., :2], atol=0.3)
    [back] = UsdGeom.Subset.GetAllGeomSubsets(mesh)
    np.testing.assert_array_equal(back.GetIndicesAttr().Get(), np.flatnonzero(~up))


def test_doubled_faces_alone_are_taken_out(tmp_path):
    write(tmp_path / "in.usda", POINTS, [*FACES, *FACES], moving=False)
    options = SimplifyOptions(ratio=0.9, device="cpu")
    [prim] = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options).prims
    assert (prim.status, prim.faces_before, prim.faces_after) == ("simplified", 144, 72)
    assert prim.problems == [f"{FLAW}: faces that repeat another, left out: 72"]


def test_info_counts_faces_of_unlike_winding(tmp_path):
    write(tmp_path / "in.usda", *flaws()["faces the wrong way round"], moving=False)
    [info] = inspect_stage(tmp_path / "in.usda")
    assert "triangles wound unlike most around them: 15" in info.problems


@pytest.mark.parametrize(("back", "shift"), [(False, 0), (False, 1), (True, 0), (True, 2)])
def test_repeated_quadrilaterals_are_found_as_triangles_are(back, shift, tmp_path):
    quads = INDICES.reshape(-1, 4)
    copies = np.roll(quads[:, ::-1] if back else quads, shift, axis=1)
    write(tmp_path / "in.usda", POINTS, [*quads.tolist(), *copies.tolist()], moving=False)
    options = SimplifyOptions(ratio=0.9, device="cpu")
    [prim] = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options).prims
    what = "faces on the back of another, kept as its other side" if back else "faces that repeat another, left out"
    assert prim.problems == [f"{FLAW}: {what}: 72"]
