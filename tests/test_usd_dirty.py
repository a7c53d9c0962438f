"""Files with broken or odd topology."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, Vt
from test_usd_stages import cloth_stage, define_cloth, quad_grid, waves
from usd_checks import check_stage, compare_properties

from warpqem.errors import StageError
from warpqem.usd import SimplifyOptions, simplify_stage

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
    mesh.CreateFaceVertexCountsAttr([3] * len(faces))
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
    options = SimplifyOptions(ratio=0.5, device="cpu", flatten=flatten)
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
    options = SimplifyOptions(ratio=0.5, device="cpu", flatten=flatten)
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
    simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(lods=(0.5, 0.2), device="cpu"))
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    for level in range(3):
        stage.GetDefaultPrim().GetVariantSet("LOD").SetVariantSelection(f"LOD{level}")
        counts = UsdGeom.Mesh(stage.GetPrimAtPath(VARYING)).GetFaceVertexCountsAttr()
        assert [len(counts.Get(time)) for time in (1.0, 2.0)] == [9, 16]


def test_strict_refuses_varying_topology_and_writes_nothing(tmp_path):
    varying_stage(tmp_path / "in.usda")
    options = SimplifyOptions(ratio=0.5, device="cpu", strict=True)
    with pytest.raises(StageError, match=rf"{VARYING}\.faceVertexCounts: changes at time 2"):
        simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options)
    assert not (tmp_path / "out.usda").exists()


def test_points_that_change_in_number_under_the_same_faces_are_named(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    define_cloth(stage, VARYING, times=[1.0, 2.0])
    attribute = UsdGeom.Mesh(stage.GetPrimAtPath(VARYING)).GetPointsAttr()
    attribute.Set([*attribute.Get(2.0), (0, 0, 0)], 2.0)
    stage.Save()
    options = SimplifyOptions(ratio=0.5, device="cpu")
    [failed] = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options).failed
    assert str(failed.message).startswith(f"{VARYING}.points: 82 points at time 2, 81 before")
