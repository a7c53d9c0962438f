"""Texture coordinates, normals and colours of USD files, compared: every interpolation, and what does not fit."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, Vt
from typer.testing import CliRunner

from tests.support.rich_stage import CLOTH, COUNTS, INDICES, LENGTHS, NAMES, POINTS, SIZE
from tests.support.usd_stages import FRAMES, cloth_stage, skinned_stage
from warpqem.cli.main import app
from warpqem.usd import CompareOptions, SimplifyOptions, compare_stages, simplify_stage
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.skeleton_poses import StagePoses


def appearance(tmp_path: Path, first, second, times=FRAMES):
    """Compare two cloths, each changed by a function of its mesh, and what texture, shading and colours differ by."""
    paths = []
    for name, change in (("a.usda", first), ("b.usda", second)):
        stage = cloth_stage(tmp_path / name, times=times)
        change(UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)))
        stage.Save()
        paths.append(tmp_path / name)
    [pair] = compare_stages(*paths, CompareOptions(samples=100, device="cpu"))
    assert pair.message is None
    return pair.appearance


def nothing(mesh):
    """Author nothing more."""


def flat(points) -> np.ndarray:
    return np.asarray(points)[:, :2] / SIZE


def with_uv(shift=(0.0, 0.0), interpolation="vertex", indexed=False, kind=NAMES.TexCoord2fArray, name="st"):
    """Texture coordinates x and y, moved by a shift."""

    def change(mesh):
        values = {"vertex": flat(POINTS), "varying": flat(POINTS), "faceVarying": flat(POINTS[INDICES])}[interpolation]
        primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(name, kind, interpolation)
        values = values + np.asarray(shift)
        if indexed:
            values, index = np.unique(values, axis=0, return_inverse=True)
            primvar.Set(Vt.Vec2fArray.FromNumpy(values.astype(np.float32)))
            primvar.SetIndices(Vt.IntArray.FromNumpy(index.ravel().astype(np.int32)))
        else:
            primvar.Set(Vt.Vec2fArray.FromNumpy(values.astype(np.float32)))

    return change


@pytest.mark.parametrize("indexed", [False, True], ids=["plain", "indexed"])
@pytest.mark.parametrize("interpolation", ["vertex", "varying", "faceVarying"])
def test_shift_of_uvs_is_found_in_every_interpolation(tmp_path, interpolation, indexed):
    found = appearance(tmp_path, with_uv(), with_uv((0.03, 0.04), interpolation, indexed))
    assert found.uvs["st"].error == pytest.approx(0.05, rel=1e-5)
    assert found.uvs["st"].error_largest == pytest.approx(0.05, rel=1e-5)
    assert found.uvs["st"].swim < 1e-3


@pytest.mark.parametrize("interpolation", list(LENGTHS))
def test_colors_of_every_interpolation_are_those_of_its_elements(tmp_path, interpolation):
    def gray(level):
        def change(mesh):
            color = np.full((LENGTHS[interpolation], 3), level, dtype=np.float32)
            primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("displayColor", NAMES.Color3fArray, interpolation)
            primvar.Set(Vt.Vec3fArray.FromNumpy(color))

        return change

    found = appearance(tmp_path, gray(0.0), gray(1.0))
    assert found.colors["displayColor"].mean == pytest.approx(100, abs=1e-3)
    assert appearance(tmp_path / "..", gray(0.5), gray(0.5)).colors["displayColor"].largest == 0


def test_color_of_each_face_is_compared_at_that_face(tmp_path):
    def checker(mesh):
        color = np.zeros((len(COUNTS), 3), dtype=np.float32)
        color[::2] = 1
        mesh.CreateDisplayColorPrimvar("uniform").Set(Vt.Vec3fArray.FromNumpy(color))

    def same_by_corner(mesh):
        color = np.zeros((len(COUNTS), 4, 3), dtype=np.float32)
        color[::2] = 1
        mesh.CreateDisplayColorPrimvar("faceVarying").Set(Vt.Vec3fArray.FromNumpy(color.reshape(-1, 3)))

    assert appearance(tmp_path, checker, same_by_corner).colors["displayColor"].largest < 1e-6


def test_uvs_that_move_over_time_swim_by_that(tmp_path):
    def moving(mesh):
        primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", NAMES.TexCoord2fArray, "vertex")
        for time, shift in zip(FRAMES, (0.0, 0.01, 0.02), strict=True):
            primvar.Set(Vt.Vec2fArray.FromNumpy((flat(POINTS) + np.array([shift, 0])).astype(np.float32)), time)

    found = appearance(tmp_path, with_uv(), moving)
    # 0.02 of a texture that spans 8 units, on slopes of up to 0.7, of a diagonal of about 11.6.
    assert 100 * 0.02 * 8 / 12 < found.uvs["st"].swim < 1.3 * 100 * 0.02 * 8 / 11
    assert found.uvs["st"].error_largest == pytest.approx(0.02, rel=1e-4)


@pytest.mark.parametrize("left_handed", [False, True])
def test_normals_of_the_attribute_and_of_the_primvar_are_compared(tmp_path, left_handed):
    def attribute(mesh):
        mesh.CreateNormalsAttr(Vt.Vec3fArray(len(POINTS), Gf.Vec3f(0, 0, 1)))
        mesh.SetNormalsInterpolation("vertex")

    def primvar(mesh):
        mesh.CreateNormalsAttr(Vt.Vec3fArray(len(POINTS), Gf.Vec3f(1, 0, 0)))
        if left_handed:
            mesh.CreateOrientationAttr("leftHanded")
            order = np.asarray(INDICES).reshape(-1, 4)[:, ::-1].ravel()
            mesh.GetFaceVertexIndicesAttr().Set(Vt.IntArray.FromNumpy(np.ascontiguousarray(order)))
        turned = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("normals", NAMES.Normal3fArray, "faceVarying")
        turned.Set(Vt.Vec3fArray(len(INDICES), Gf.Vec3f(0, 0.6, 0.8)))

    angle = np.degrees(np.arccos(0.8))
    found = appearance(tmp_path, attribute, primvar).normals
    assert found.mean == pytest.approx(angle, rel=1e-6)
    assert found.largest == pytest.approx(angle, rel=1e-6)


def test_corners_of_a_left_handed_mesh_keep_their_values(tmp_path):
    def turned(mesh):
        mesh.CreateOrientationAttr("leftHanded")
        order = INDICES.reshape(-1, 4)[:, ::-1].ravel()
        mesh.GetFaceVertexIndicesAttr().Set(Vt.IntArray.FromNumpy(np.ascontiguousarray(order)))
        primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", NAMES.TexCoord2fArray, "faceVarying")
        primvar.Set(Vt.Vec2fArray.FromNumpy(flat(POINTS[order]).astype(np.float32)))

    found = appearance(tmp_path, with_uv(interpolation="faceVarying"), turned, times=None)
    assert found.uvs["st"].error_largest < 1e-3


def test_colors_inherited_from_above_count(tmp_path):
    def above(mesh):
        parent = UsdGeom.PrimvarsAPI(mesh.GetPrim().GetParent())
        parent.CreatePrimvar("displayColor", NAMES.Color3fArray, "constant").Set([Gf.Vec3f(1, 1, 1)])

    def own(mesh):
        mesh.CreateDisplayColorPrimvar("constant").Set([Gf.Vec3f(0, 0, 0)])

    assert appearance(tmp_path, above, own).colors["displayColor"].mean == pytest.approx(100, abs=1e-3)


def wrong_length(mesh):
    UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", NAMES.TexCoord2fArray, "vertex").Set([Gf.Vec2f(0, 0)] * 5)


def not_finite(mesh):
    values = flat(POINTS).astype(np.float32)
    values[7] = np.nan
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", NAMES.TexCoord2fArray, "vertex")
    primvar.Set(Vt.Vec2fArray.FromNumpy(values))


def bad_indices(mesh):
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", NAMES.TexCoord2fArray, "vertex")
    primvar.Set([Gf.Vec2f(0, 0)])
    primvar.SetIndices(Vt.IntArray(len(POINTS), 3))


def blocked_at_a_time(mesh):
    with_uv()(mesh)
    attribute = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st").GetAttr()
    attribute.Set(attribute.Get(), 1.0)
    attribute.Set(Sdf.ValueBlock(), 2.0)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (nothing, "the test mesh has no st"),
        (wrong_length, "test mesh: st has 5 values at the default time, 81 are needed"),
        (not_finite, "test mesh: st has a value that is not finite at the default time"),
        (bad_indices, "test mesh: st has no values, or indices that are not of its values"),
        (blocked_at_a_time, "test mesh: st has no value at time 2"),
        (with_uv(interpolation="vertex", name="uv2"), "the test mesh has no st"),
    ],
)
def test_uvs_that_cannot_be_compared_say_why(tmp_path, change, reason):
    found = appearance(tmp_path, with_uv(), change)
    assert "st" not in found.uvs
    assert found.not_measured["st"].startswith(reason)


def test_normals_of_the_rest_pose_are_not_compared_with_those_of_a_moving_mesh(tmp_path):
    stage = skinned_stage(tmp_path / "skinned.usda")
    mesh = next(UsdGeom.Mesh(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh))
    mesh.CreateNormalsAttr(Vt.Vec3fArray(len(mesh.GetPointsAttr().Get()), Gf.Vec3f(0, 0, 1)))
    stage.Save()
    source = MeshSource(mesh.GetPrim(), StagePoses(stage))
    baked = Usd.Stage.CreateNew(str(tmp_path / "baked.usda"))
    copy = UsdGeom.Mesh.Define(baked, mesh.GetPath())
    for name in ("faceVertexCounts", "faceVertexIndices", "normals"):
        copy.GetPrim().GetAttribute(name).Set(mesh.GetPrim().GetAttribute(name).Get())
    for time in source.authored_times:
        copy.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(source.points_at(time)), time)
    baked.Save()
    paths = tmp_path / "skinned.usda", tmp_path / "baked.usda"
    [pair] = compare_stages(*paths, CompareOptions(samples=100, device="cpu"))
    assert pair.appearance.normals is None
    assert "rest pose" in pair.appearance.not_measured["normals"]


def test_a_simplified_cloth_keeps_its_texture(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    with_uv(interpolation="faceVarying")(UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)))
    stage.Save()
    simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(ratio=0.5, device="cpu"))
    [pair] = compare_stages(tmp_path / "in.usda", tmp_path / "out.usda", CompareOptions(samples=100, device="cpu"))
    assert 0 < pair.appearance.uvs["st"].error < 0.05
    assert pair.appearance.not_measured["st: seam drift"] == "neither mesh has a seam of st"


def test_command_shows_the_figures_and_the_reasons(tmp_path):
    appearance(tmp_path, with_uv(), with_uv((0.3, 0.4)))
    paths = [str(tmp_path / name) for name in ("a.usda", "b.usda")]
    json_path = str(tmp_path / "out.json")
    done = CliRunner().invoke(app, ["compare", *paths, "--samples", "100", "--device", "cpu", "--json", json_path])
    assert done.exit_code == 0
    assert "UV" in done.output
    assert "normals: none, as neither mesh has normals" in done.output
    [mesh] = json.loads(Path(json_path).read_text())["prims"]
    assert mesh["appearance"]["uvs"]["st"]["error"] == pytest.approx(0.5, rel=1e-5)
    assert mesh["appearance"]["normals"] is None
    assert mesh["comparison"]["slide_p95"] is not None
