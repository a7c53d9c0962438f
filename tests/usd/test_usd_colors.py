"""Colours on simplified meshes: borders between them, gradients, and what a vertex beside a border gets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, Vt

from tests.support.usd_stages import cloth_stage
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.commands.attributes import BORDER_WEIGHT, COLOR_WEIGHT, weighted_fields
from warpqem.usd.read.mesh_seams import find_seams
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.skeleton_poses import StagePoses
from warpqem.usd.write.vertex_colors import fitted_values

SIZE = 48
WHITE, RED = (1, 1, 1), (1, 0, 0)
SAMPLES = (np.arange(96) + 0.5) / 96 * SIZE


def in_disc(points: np.ndarray) -> np.ndarray:
    return ((points[..., :2] - SIZE / 2) ** 2).sum(axis=-1) < (0.3 * SIZE) ** 2


def disc_stage(path: Path, kind: str) -> None:
    """A flat sheet of triangles with a red disc on white, painted in one of the ways that there are."""
    stage = cloth_stage(path, size=SIZE, times=None, triangles=True)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth"))
    points = np.array(mesh.GetPointsAttr().Get()) * np.float32([1, 1, 0])
    mesh.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(points))
    faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    of_faces = in_disc(points[faces].mean(axis=1)).astype(np.int32)
    if kind == "subset":
        chosen = Vt.IntArray.FromNumpy(np.flatnonzero(of_faces).astype(np.int32))
        UsdGeom.Subset.CreateGeomSubset(mesh, "disc", "face", chosen, "materialBind", "nonOverlapping")
    elif kind == "opacity":
        mesh.CreateDisplayOpacityPrimvar("vertex").Set((1.0 - in_disc(points)).tolist())
    else:
        elements = {"vertex": in_disc(points).astype(np.int32), "faceVarying": np.repeat(of_faces, 3)}
        primvar = mesh.CreateDisplayColorPrimvar(kind)
        primvar.Set([WHITE, RED])
        primvar.SetIndices(Vt.IntArray.FromNumpy(elements.get(kind, of_faces)))
    stage.Save()


def seen(path: Path) -> np.ndarray:
    """How white the sheet is at each sample, (96, 96)."""
    stage = Usd.Stage.Open(str(path))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth"))
    faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    primvar = mesh.GetDisplayColorPrimvar()
    subsets = UsdGeom.Subset.GetAllGeomSubsets(mesh)
    if subsets:
        at_corners = np.ones((len(faces), 3))
        at_corners[np.array(subsets[0].GetIndicesAttr().Get())] = 0
    elif primvar.HasAuthoredValue():
        green = np.array(primvar.ComputeFlattened())[:, 1]
        elements = {"vertex": faces, "uniform": np.repeat(np.arange(len(faces))[:, None], 3, axis=1)}
        at_corners = green[elements.get(primvar.GetInterpolation(), np.arange(faces.size).reshape(-1, 3))]
    else:
        at_corners = np.array(mesh.GetDisplayOpacityPrimvar().ComputeFlattened())[faces]
    x, y = np.meshgrid(SAMPLES, SAMPLES)
    white = np.full(x.shape, np.nan)
    for (a, b, c), values in zip(np.array(mesh.GetPointsAttr().Get())[faces][:, :, :2], at_corners, strict=True):
        area = (b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0]
        if area == 0:
            continue
        second = ((x - a[0]) * (c - a)[1] - (y - a[1]) * (c - a)[0]) / area
        third = ((b - a)[0] * (y - a[1]) - (b - a)[1] * (x - a[0])) / area
        inside = (second >= -1e-6) & (third >= -1e-6) & (second + third <= 1 + 1e-6)
        white[inside] = (values[0] + second * (values[1] - values[0]) + third * (values[2] - values[0]))[inside]
    return white


@pytest.mark.parametrize("kind", ["uniform", "faceVarying", "vertex", "opacity", "subset"])
def test_disc_keeps_its_place_at_few_faces(tmp_path, kind):
    disc_stage(tmp_path / "in.usda", kind)
    report = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(ratio=0.03))
    assert report.prims[0].faces_after <= 0.03 * 2 * SIZE * SIZE + 1
    before, after = seen(tmp_path / "in.usda") < 0.5, seen(tmp_path / "out.usda") < 0.5
    assert (before & after).sum() / (before | after).sum() >= 0.95


def small_source(interpolation: str, values: object, size: int = 4) -> MeshSource:
    stage = cloth_stage(size=size, times=None)
    UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth")).CreateDisplayColorPrimvar(interpolation).Set(values)
    return MeshSource(stage.GetPrimAtPath("/Root/Cloth"), StagePoses(stage))


def test_border_between_colors_of_faces_is_a_seam():
    source = small_source("uniform", [WHITE if face % 4 < 2 else RED for face in range(16)])
    seams = find_seams(source, source.topology.triangles)
    assert seams.hold().tolist() == [[2, 7], [7, 12], [12, 17], [17, 22]]


def test_color_of_every_face_is_not_held_but_named():
    source = small_source("uniform", [(face / 16, 0, 0) for face in range(16)])
    seams = find_seams(source, source.topology.triangles)
    assert len(seams.hold()) == 0
    assert seams.dense == ["primvars:displayColor"]


def test_number_of_every_face_is_neither_held_nor_named():
    source = small_source("constant", [WHITE])
    primvar = UsdGeom.PrimvarsAPI(source.prim).CreatePrimvar("heat", Sdf.ValueTypeNames.FloatArray, "uniform")
    primvar.Set([float(face) for face in range(16)])
    seams = find_seams(source, source.topology.triangles)
    assert len(seams.hold()) == 0
    assert seams.dense == []


def weights_of(source: MeshSource) -> list[float]:
    return [field.weight for field in weighted_fields(source, 0.0, ())]


def test_gradient_of_colors_has_a_default_weight():
    assert weights_of(small_source("vertex", [(x / 4, 0, 0) for _ in range(5) for x in range(5)])) == [COLOR_WEIGHT]


def test_border_of_vertex_colors_has_a_default_weight():
    source = small_source("vertex", [WHITE if x < 5 else RED for _ in range(11) for x in range(11)], size=10)
    assert weights_of(source) == [BORDER_WEIGHT]


def test_colors_of_high_range_count_as_if_they_ranged_to_one():
    source = small_source("vertex", [(10.0 * x, 0, 0) for _ in range(5) for x in range(5)])
    assert weights_of(source) == pytest.approx([COLOR_WEIGHT / 40])


@pytest.mark.parametrize(
    ("interpolation", "values"),
    [
        ("constant", [RED]),
        ("uniform", [RED] * 16),
        ("vertex", [RED] * 25),
        ("faceVarying", [RED if corner < 32 else WHITE for corner in range(64)]),
        ("vertex", [(float("nan"), 0, 0)] * 25),
    ],
)
def test_colors_that_do_not_vary_within_faces_have_no_weight(interpolation, values):
    assert weights_of(small_source(interpolation, values)) == []


def test_color_of_a_vertex_fits_all_faces_it_stands_for():
    # Two triangles in a row along x: white up to x = 1, then fading to red at x = 2. The left one is ten times as high.
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 10, 0], [1, 0, 1], [2, 0, 0]], dtype=float)
    faces = np.array([[0, 1, 2], [1, 4, 3]], dtype=np.int32)
    values = np.array([[[1.0], [1.0], [1.0]], [[1.0], [0.0], [1.0]]])
    cluster = np.array([[0, 1, 2], [1, 1, 1]], dtype=np.int32)
    new = np.array([[0, 0, 0], [2, 0, 0], [0, 10, 0]], dtype=float)
    fitted, found = fitted_values(values, points, faces, cluster, new)
    # The nearest point of the surface is red; by area, 5 to 3 times 0.5, it is nearly white.
    assert found.all()
    assert fitted[:, 0] == pytest.approx([1.0, 5.0 / 6.5, 1.0])


def test_color_of_a_surface_of_one_color_stays_to_the_bit():
    rng = np.random.default_rng(1)
    points, faces = rng.normal(size=(30, 3)), rng.integers(0, 30, (40, 3)).astype(np.int32)
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    values = np.full((len(faces), 3, 1), np.float32(0.1))
    fitted, found = fitted_values(values, points, faces, faces // 3, rng.normal(size=(10, 3)))
    assert (fitted[found] == np.float32(0.1)).all()


def test_scene_without_colors_is_simplified_as_ever(tmp_path):
    """Giving a mesh one colour changes no bit of its shape."""
    outputs = []
    for name in ("plain", "red"):
        stage = cloth_stage(tmp_path / f"{name}.usda", size=12)
        if name == "red":
            UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth")).CreateDisplayColorPrimvar("vertex").Set([RED] * 169)
            stage.Save()
        simplify_stage(tmp_path / f"{name}.usda", tmp_path / f"{name}_out.usda", SimplifyOptions(ratio=0.2))
        opened = Usd.Stage.Open(str(tmp_path / f"{name}_out.usda"))
        mesh = UsdGeom.Mesh(opened.GetPrimAtPath("/Root/Cloth"))
        outputs.append([np.array(mesh.GetPointsAttr().Get(time)) for time in (1.0, 4.0)])
    assert np.array_equal(outputs[0], outputs[1])
