"""Primvars, normals and other arrays on the simplified mesh."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, Vt

from tests.support.usd_stages import cloth_stage, quad_grid
from warpqem.usd import SimplifyOptions, simplify_stage

CLOTH = "/Root/Cloth"
SIZE = 8
POINTS, _, INDICES = quad_grid(SIZE)
QUADS = INDICES.reshape(-1, 4)
NAMES = Sdf.ValueTypeNames
# Types of values as a binary layer numbers them, the first with the bit of an array.
VEC3F_ARRAY, FLOAT = 0x8000 | 24, 8


class Flat:
    """A flat, still grid of 8 x 8 quads whose values are set, then simplified."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.stage = cloth_stage(folder / "in.usda", times=None)
        self.mesh = UsdGeom.Mesh(self.stage.GetPrimAtPath(CLOTH))
        self.mesh.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(POINTS))
        self.dropped: list[str] = []

    def primvar(self, name: str, kind: Sdf.ValueTypeName, interpolation: str, size: int = -1) -> UsdGeom.Primvar:
        return UsdGeom.PrimvarsAPI(self.mesh).CreatePrimvar(name, kind, interpolation, size)

    def simplified(self, **options: object) -> UsdGeom.Mesh:
        self.stage.Save()
        given = SimplifyOptions(**{"ratio": 0.3, "device": "cpu", **options})
        report = simplify_stage(self.folder / "in.usda", self.folder / "out.usda", given)
        [prim] = report.prims
        assert prim.status == "simplified"
        self.dropped = prim.dropped
        self.result = Usd.Stage.Open(str(self.folder / "out.usda"))
        return UsdGeom.Mesh(self.result.GetPrimAtPath(CLOTH))


@pytest.fixture
def flat(tmp_path) -> Flat:
    return Flat(tmp_path)


def points_of(mesh: UsdGeom.Mesh) -> np.ndarray:
    return np.array(mesh.GetPointsAttr().Get())


def faces_of(mesh: UsdGeom.Mesh) -> np.ndarray:
    return np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)


def value_of(mesh: UsdGeom.Mesh, name: str, time: float | None = None) -> np.ndarray:
    code = Usd.TimeCode.Default() if time is None else Usd.TimeCode(time)
    return np.array(UsdGeom.PrimvarsAPI(mesh).GetPrimvar(name).ComputeFlattened(code))


def is_right(mesh: UsdGeom.Mesh) -> np.ndarray:
    """For each face, whether it lies right of the middle."""
    return points_of(mesh)[faces_of(mesh)][:, :, 0].mean(axis=1) > SIZE / 2


@pytest.mark.parametrize("interpolation", ["vertex", "varying"])
def test_point_values_follow_the_surface(flat, interpolation):
    flat.primvar("x", NAMES.FloatArray, interpolation).Set(POINTS[:, 0].tolist())
    mesh = flat.simplified()
    np.testing.assert_allclose(value_of(mesh, "x"), points_of(mesh)[:, 0], atol=1e-4)


def test_corner_values_follow_the_surface(flat):
    flat.primvar("st", NAMES.TexCoord2fArray, "faceVarying").Set(
        Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(POINTS[INDICES, :2]))
    )
    mesh = flat.simplified()
    np.testing.assert_allclose(value_of(mesh, "st"), points_of(mesh)[faces_of(mesh).ravel(), :2], atol=1e-4)


def test_corner_values_without_seams_get_one_entry_for_each_vertex(flat):
    flat.primvar("st", NAMES.TexCoord2fArray, "faceVarying").Set(
        Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(POINTS[INDICES, :2]))
    )
    right = np.flatnonzero(QUADS.min(axis=1) % (SIZE + 1) >= SIZE // 2).tolist()
    # The border of a subset is a seam, but none of the texture coordinates.
    UsdGeom.Subset.CreateGeomSubset(flat.mesh, "right", "face", right, "materialBind", "nonOverlapping")
    mesh = flat.simplified()
    assert len(UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st").Get()) == len(points_of(mesh))


def test_values_do_not_cross_a_seam(flat):
    right = np.repeat(QUADS.min(axis=1) % (SIZE + 1) >= SIZE // 2, 4)
    flat.primvar("island", NAMES.FloatArray, "faceVarying").Set((100.0 * right).tolist())
    mesh = flat.simplified()
    np.testing.assert_array_equal(value_of(mesh, "island"), np.repeat(100.0 * is_right(mesh), 3))


def test_seam_stays_a_line_of_edges(flat):
    right = np.repeat(QUADS.min(axis=1) % (SIZE + 1) >= SIZE // 2, 4)
    flat.primvar("island", NAMES.FloatArray, "faceVarying").Set((100.0 * right).tolist())
    mesh = flat.simplified()
    x = points_of(mesh)[faces_of(mesh)][:, :, 0]
    # A tenth of a quad: the regularisation towards the material may move vertices a little off the line.
    assert ((x <= SIZE / 2 + 0.1).all(axis=1) | (x >= SIZE / 2 - 0.1).all(axis=1)).all()


def test_whole_numbers_and_strings_come_from_the_input_unchanged(flat):
    flat.primvar("number", NAMES.IntArray, "vertex").Set((np.arange(81) * 10).tolist())
    flat.primvar("name", NAMES.StringArray, "vertex").Set([str(index * 10) for index in range(81)])
    mesh = flat.simplified()
    numbers = value_of(mesh, "number")
    assert set(numbers) <= set(range(0, 810, 10))
    assert [int(name) for name in value_of(mesh, "name")] == numbers.tolist()
    nearest = POINTS[numbers // 10]
    assert np.abs(nearest - points_of(mesh)).max() <= 1.0


def test_face_values_are_those_of_a_face_that_the_new_one_goes_on_from(flat):
    flat.primvar("side", NAMES.TokenArray, "uniform").Set(
        ["right" if quad % (SIZE + 1) >= SIZE // 2 else "left" for quad in QUADS.min(axis=1)]
    )
    members = np.flatnonzero(QUADS.min(axis=1) % (SIZE + 1) >= SIZE // 2).tolist()
    UsdGeom.Subset.CreateGeomSubset(flat.mesh, "right", "face", members, "sides", "nonOverlapping")
    mesh = flat.simplified()
    assert (value_of(mesh, "side") == np.where(is_right(mesh), "right", "left")).all()


def test_indexed_values_are_read_through_their_indices(flat):
    primvar = flat.primvar("x", NAMES.FloatArray, "vertex")
    primvar.Set(np.arange(SIZE + 1.0)[::-1].tolist())
    primvar.SetIndices((SIZE - POINTS[:, 0]).astype(int).tolist())
    mesh = flat.simplified()
    np.testing.assert_allclose(value_of(mesh, "x"), points_of(mesh)[:, 0], atol=1e-4)


def test_elements_of_several_numbers_stay_together(flat):
    flat.primvar("pair", NAMES.FloatArray, "vertex", 2).Set(np.ascontiguousarray(POINTS[:, :2]).ravel().tolist())
    mesh = flat.simplified()
    assert UsdGeom.PrimvarsAPI(mesh).GetPrimvar("pair").GetElementSize() == 2
    np.testing.assert_allclose(value_of(mesh, "pair").reshape(-1, 2), points_of(mesh)[:, :2], atol=1e-4)


def test_every_sample_is_transferred(flat):
    primvar = flat.primvar("x", NAMES.FloatArray, "vertex")
    for time in (3.0, 7.5):
        primvar.Set((time * POINTS[:, 0]).tolist(), time)
    mesh = flat.simplified()
    assert UsdGeom.PrimvarsAPI(mesh).GetPrimvar("x").GetTimeSamples() == [3.0, 7.5]
    for time in (3.0, 7.5):
        np.testing.assert_allclose(value_of(mesh, "x", time), time * points_of(mesh)[:, 0], atol=1e-3)


def test_rotations_stay_of_length_one_whatever_their_sign(flat):
    turn = Gf.Quatf(0.8, Gf.Vec3f(0.6, 0, 0))
    flat.primvar("turn", NAMES.QuatfArray, "vertex").Set([turn if index % 2 else -turn for index in range(81)])
    mesh = flat.simplified()
    for value in UsdGeom.PrimvarsAPI(mesh).GetPrimvar("turn").Get():
        assert abs(Gf.Dot(value, turn)) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("kind", [NAMES.HalfArray, NAMES.DoubleArray])
def test_precision_stays_that_of_the_input(flat, kind):
    primvar = flat.primvar("x", kind, "vertex")
    primvar.Set(POINTS[:, 0].tolist())
    mesh = flat.simplified()
    assert UsdGeom.PrimvarsAPI(mesh).GetPrimvar("x").GetTypeName() == kind
    np.testing.assert_allclose(value_of(mesh, "x"), points_of(mesh)[:, 0], atol=1e-2)


def test_matrices_are_blended(flat):
    flat.primvar("frame", NAMES.Matrix4dArray, "vertex").Set(
        [Gf.Matrix4d().SetTranslate(Gf.Vec3d(*map(float, point))) for point in POINTS]
    )
    mesh = flat.simplified()
    np.testing.assert_allclose(value_of(mesh, "frame")[:, 3, :3], points_of(mesh), atol=1e-4)


def test_constant_values_stay(flat):
    flat.primvar("tint", NAMES.Color3fArray, "constant").Set([Gf.Vec3f(1, 0, 0)])
    assert value_of(flat.simplified(), "tint").tolist() == [[1, 0, 0]]


@pytest.mark.parametrize("interpolation", ["vertex", "faceVarying"])
def test_normals_stay_of_length_one(flat, interpolation):
    tilted = np.stack([np.sin(POINTS[:, 0] * 0.1), np.zeros(81), np.cos(POINTS[:, 0] * 0.1)], axis=1).astype(np.float32)
    values = tilted if interpolation == "vertex" else tilted[INDICES]
    flat.mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values)))
    flat.mesh.SetNormalsInterpolation(interpolation)
    mesh = flat.simplified(normals="keep")
    normals = np.array(mesh.GetNormalsAttr().Get())
    x = points_of(mesh)[:, 0] if interpolation == "vertex" else points_of(mesh)[faces_of(mesh).ravel(), 0]
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-6)
    np.testing.assert_allclose(np.arctan2(normals[:, 0], normals[:, 2]), 0.1 * x, atol=1e-3)


def test_mesh_without_normals_gets_none(flat):
    assert not flat.simplified().GetNormalsAttr().HasAuthoredValue()


@pytest.mark.parametrize(("element", "count"), [("point", 81), ("face", 64), ("corner", 256)])
def test_attribute_as_long_as_the_mesh_is_left_alone_and_named(flat, element, count):
    flat.mesh.GetPrim().CreateAttribute("studio:table", NAMES.IntArray).Set(list(range(count)))
    assert list(flat.simplified().GetPrim().GetAttribute("studio:table").Get()) == list(range(count))
    assert flat.dropped == [f"the order of studio:table (an entry for each old {element}; make it a primvar)"]


def test_attribute_of_another_length_is_left_alone(flat):
    flat.mesh.GetPrim().CreateAttribute("studio:x", NAMES.FloatArray).Set([1.0, 2.0])
    assert list(flat.simplified().GetPrim().GetAttribute("studio:x").Get()) == [1.0, 2.0]


def test_velocities_at_the_times_of_the_points_are_transferred(flat):
    flat.mesh.GetPointsAttr().Clear()
    for time in (1.0, 2.0):
        flat.mesh.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(POINTS + np.float32(time)), time)
        flat.mesh.CreateVelocitiesAttr().Set([Gf.Vec3f(time)] * 81, time)
    mesh = flat.simplified()
    assert flat.dropped == []
    np.testing.assert_allclose(mesh.GetVelocitiesAttr().Get(2.0), np.full((len(mesh.GetPointsAttr().Get(2.0)), 3), 2.0))


def test_velocities_at_other_times_are_dropped(flat):
    flat.mesh.CreateVelocitiesAttr().Set([Gf.Vec3f(1)] * 81, 5.0)
    assert not flat.simplified().GetVelocitiesAttr().HasAuthoredValue()
    assert flat.dropped == ["velocities"]


def test_inherited_primvar_is_left_alone(flat):
    root = UsdGeom.PrimvarsAPI(flat.stage.GetPrimAtPath("/Root"))
    root.CreatePrimvar("tint", NAMES.FloatArray, "constant").Set([0.5])
    mesh = flat.simplified()
    assert not mesh.GetPrim().HasAttribute("primvars:tint")


def test_samples_of_several_types_are_dropped(flat):
    flat.mesh.GetPointsAttr().Clear()
    for time in (1.0, 2.0):
        flat.mesh.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(POINTS + np.float32(time)), time)
        flat.mesh.CreateVelocitiesAttr().Set([Gf.Vec3f(time + 0.5)] * 81, time)
    flat.stage.Export(str(flat.folder / "binary.usdc"))
    # USD does not write such a file; one byte of damage does.
    data = bytearray((flat.folder / "binary.usdc").read_bytes())
    values = data.index(struct.pack("<Q3f", 81, 2.5, 2.5, 2.5))
    data[data.index(struct.pack("<Q", values | VEC3F_ARRAY << 48)) + 6] = FLOAT
    (flat.folder / "damaged.usdc").write_bytes(data)
    report = simplify_stage(flat.folder / "damaged.usdc", flat.folder / "out.usda", SimplifyOptions(ratio=0.3))
    assert [prim.dropped for prim in report.prims] == [["velocities"]]


@pytest.mark.parametrize("error", [TypeError, ValueError])
@pytest.mark.parametrize("name", ["normals", "primvars:st"])
def test_a_fault_in_a_fit_fails_the_mesh_and_drops_no_attribute(name, error, flat, monkeypatch):
    def broken(*_):
        raise error("broken")

    if name == "normals":
        flat.mesh.CreateNormalsAttr([(0.0, 0.0, 1.0)] * len(POINTS))
    else:
        flat.primvar("st", NAMES.TexCoord2fArray, "vertex").Set([(x, y) for x, y, _ in POINTS.tolist()])
    flat.stage.Save()
    monkeypatch.setattr("warpqem.usd.write.primvars.fit_transferred", broken)
    given = SimplifyOptions(ratio=0.3, device="cpu", normals="fit")
    [prim] = simplify_stage(flat.folder / "in.usda", flat.folder / "out.usda", given).prims
    assert prim.status == "failed"
    assert f"{error.__name__} in the fit of {name}: broken" in prim.message
