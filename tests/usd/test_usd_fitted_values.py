"""Normals, texture coordinates and colours of files, fitted to the input's surface."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from tests.support import meshes
from tests.support.usd_stages import FRAMES, cloth_stage, skinned_stage
from warpqem.mesh.smooth_normals import vertex_normals
from warpqem.usd import FrameRange, SimplifyOptions, simplify_stage
from warpqem.usd.commands.appearance import stage_looks
from warpqem.usd.write import attribute_transfer
from warpqem.usd.write.spread import spread

CLOTH, BODY = "/Root/Cloth", "/Char/Body"
SCENES = Path(__file__).resolve().parents[2] / "scenes"
NAMES = Sdf.ValueTypeNames


def simplified(folder, path, ratio=0.3, **options) -> UsdGeom.Mesh:
    # Another file each time: a stage that was opened before keeps its layers.
    output = folder / f"out{len(list(folder.iterdir()))}.usda"
    report = simplify_stage(folder / "in.usda", output, SimplifyOptions(ratio=ratio, device="cpu", **options))
    assert [prim.status for prim in report.prims] == ["simplified"]
    # A mesh does not keep its stage alive.
    simplified.stage = Usd.Stage.Open(str(output))
    return UsdGeom.Mesh(simplified.stage.GetPrimAtPath(path))


def define_bumps(folder, normals=None, interpolation="vertex", orientation="rightHanded", shape=None) -> UsdGeom.Mesh:
    """A bumpy sphere, or another shape, as a stage of one mesh, with the normals of its faces by default."""
    points, faces = meshes.bumpy_sphere(3) if shape is None else shape
    stage = Usd.Stage.CreateNew(str(folder / "in.usda"))
    define_bumps.stage = stage
    mesh = UsdGeom.Mesh.Define(stage, "/Bumps")
    mesh.CreateSubdivisionSchemeAttr("none")
    mesh.CreateOrientationAttr(orientation)
    outward = faces[:, ::-1] if orientation == "leftHanded" else faces
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(points, dtype=np.float32)))
    mesh.CreateFaceVertexCountsAttr([3] * len(faces))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(outward.ravel())))
    if normals is None:
        own = vertex_normals(points.astype(np.float32), faces)
        normals = own if interpolation == "vertex" else own[outward.ravel()]
    if len(normals):
        mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(normals)))
        mesh.SetNormalsInterpolation(interpolation)
    stage.Save()
    return mesh


def corner_normals(mesh, time=None) -> np.ndarray:
    code = Usd.TimeCode.Default() if time is None else time
    normals = np.array(mesh.GetNormalsAttr().Get(code))
    index = np.array(mesh.GetFaceVertexIndicesAttr().Get())
    return (normals[index] if mesh.GetNormalsInterpolation() == "vertex" else normals).reshape(-1, 3, 3)


def angle_to_input(mesh, normals=None) -> float:
    """Mean angle between the shading of the middles of faces and that of the bumpy sphere below them."""
    points, faces = meshes.bumpy_sphere(4)
    own = vertex_normals(points.astype(np.float32), faces)
    index = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    middle = np.array(mesh.GetPointsAttr().Get())[index].mean(axis=1)
    shown = (corner_normals(mesh) if normals is None else normals).mean(axis=1)
    shown /= np.linalg.norm(shown, axis=1, keepdims=True)
    nearest = np.linalg.norm(middle[:, None] - points[None], axis=2).argmin(axis=1)
    return float(np.degrees(np.arccos(np.clip((shown * own[nearest]).sum(axis=1), -1, 1))).mean())


@pytest.mark.parametrize("orientation", ["rightHanded", "leftHanded"])
@pytest.mark.parametrize("interpolation", ["vertex", "faceVarying"])
def test_fitted_normals_are_nearer_than_kept_ones(tmp_path, interpolation, orientation):
    define_bumps(tmp_path, interpolation=interpolation, orientation=orientation)
    angles = [angle_to_input(simplified(tmp_path, "/Bumps", 0.1, normals=how)) for how in ("fit", "keep")]
    assert angles[0] < 0.9 * angles[1]


def test_normals_stay_where_a_fit_would_draw_all_of_them_aside(tmp_path):
    points, faces = meshes.grid(12, 12)
    normals = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    # A dent that the few faces left have no point in.
    normals[np.abs(points[:, :2] - 0.5).max(axis=1) < 0.15] = [0.8, 0.0, 0.6]
    define_bumps(tmp_path, normals=normals.astype(np.float32), shape=(points, faces))
    mesh = simplified(tmp_path, "/Bumps", 0.01, normals="fit")
    found = corner_normals(mesh).reshape(-1, 3)
    np.testing.assert_allclose(found, np.tile([0.0, 0.0, 1.0], (len(found), 1)), atol=1e-6)


def test_fitted_normals_have_length_one(tmp_path):
    define_bumps(tmp_path)
    normals = np.array(simplified(tmp_path, "/Bumps", 0.1).GetNormalsAttr().Get())
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-6)


@pytest.mark.parametrize("how", ["fit", "keep"])
@pytest.mark.parametrize("orientation", ["rightHanded", "leftHanded"])
def test_normals_of_length_zero_become_those_of_the_new_faces(tmp_path, how, orientation):
    mesh = define_bumps(tmp_path, orientation=orientation)
    own = np.array(mesh.GetNormalsAttr().Get())
    lost = np.array(mesh.GetPointsAttr().Get())[:, 0] > 0
    mesh.GetNormalsAttr().Set(Vt.Vec3fArray.FromNumpy(np.where(lost[:, None], 0, own).astype(np.float32)))
    define_bumps.stage.Save()
    report = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(ratio=0.1, normals=how))
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    written = UsdGeom.Mesh(stage.GetPrimAtPath("/Bumps"))
    np.testing.assert_allclose(np.linalg.norm(np.array(written.GetNormalsAttr().Get()), axis=1), 1.0, atol=1e-5)
    # Still to the outside.
    assert angle_to_input(written) < 45
    assert any("normals of length 0: those of the new faces stand" in name for name in report.prims[0].dropped)


@pytest.mark.parametrize("orientation", ["rightHanded", "leftHanded"])
def test_normals_of_faces_of_length_zero_become_those_of_the_new_faces(tmp_path, orientation):
    mesh = define_bumps(tmp_path, orientation=orientation)
    count = len(mesh.GetFaceVertexCountsAttr().Get())
    mesh.GetNormalsAttr().Set(Vt.Vec3fArray.FromNumpy(np.zeros((count, 3), dtype=np.float32)))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.uniform)
    define_bumps.stage.Save()
    simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(ratio=0.1))
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    written = UsdGeom.Mesh(stage.GetPrimAtPath("/Bumps"))
    normals = np.array(written.GetNormalsAttr().Get())
    corners = np.array(written.GetPointsAttr().Get())[np.array(written.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward = -1.0 if orientation == "leftHanded" else 1.0
    np.testing.assert_allclose(normals, outward * cross / np.linalg.norm(cross, axis=1, keepdims=True), atol=1e-4)


def test_normals_are_fitted_by_default(tmp_path):
    define_bumps(tmp_path)
    fitted, default = (
        np.array(simplified(tmp_path, "/Bumps", 0.1, **how).GetNormalsAttr().Get()) for how in ({"normals": "fit"}, {})
    )
    assert (fitted == default).all()


def test_no_normals_are_written_where_none_are_wanted(tmp_path):
    mesh = define_bumps(tmp_path)
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("normals", NAMES.Normal3fArray, "vertex")
    primvar.Set(mesh.GetNormalsAttr().Get())
    define_bumps.stage.Save()
    out = simplified(tmp_path, "/Bumps", normals="none")
    assert not out.GetNormalsAttr().HasAuthoredValue()
    assert not out.GetPrim().GetAttribute("primvars:normals").HasAuthoredValue()


@pytest.mark.parametrize(("asked", "has"), [(None, False), ("keep", False), ("fit", True), ("none", False)])
def test_polygons_without_normals_get_some_where_fitted_ones_are_asked_for(tmp_path, asked, has):
    define_bumps(tmp_path, normals=[])
    mesh = simplified(tmp_path, "/Bumps", 0.1, normals=asked)
    assert mesh.GetNormalsAttr().HasAuthoredValue() == has
    if has:
        index = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
        own = vertex_normals(np.array(mesh.GetPointsAttr().Get()), index)[index]
        assert angle_to_input(mesh) < 0.9 * angle_to_input(mesh, own)


@pytest.mark.parametrize("orientation", ["rightHanded", "leftHanded"])
def test_subdivision_surface_is_shaded_as_the_input_in_every_frame(tmp_path, orientation):
    stage = cloth_stage(tmp_path / "in.usda")
    source = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH))
    source.GetSubdivisionSchemeAttr().Set("catmullClark")
    source.CreateOrientationAttr(orientation)
    stage.Save()
    mesh = simplified(tmp_path, CLOTH, 0.2)
    assert mesh.GetNormalsAttr().GetTimeSamples() == FRAMES
    for time in FRAMES:
        normals = corner_normals(mesh, time)
        np.testing.assert_allclose(np.linalg.norm(normals, axis=2), 1.0, atol=1e-6)
        assert ((normals[..., 2] > 0) == (orientation == "rightHanded")).all()


def texture_signs(mesh) -> np.ndarray:
    primvar = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st")
    values = np.array(primvar.ComputeFlattened(), dtype=np.float64)
    if primvar.GetInterpolation() == "vertex":
        values = values[np.array(mesh.GetFaceVertexIndicesAttr().Get())]
    corner = values.reshape(-1, 3, 2)
    edge = corner[:, 1:] - corner[:, :1]
    return np.sign(edge[:, 0, 0] * edge[:, 1, 1] - edge[:, 0, 1] * edge[:, 1, 0])


def define_texture(mesh, values, interpolation="vertex") -> None:
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", NAMES.TexCoord2fArray, interpolation)
    primvar.Set(Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(values, dtype=np.float32)))


def test_texture_is_turned_over_nowhere(tmp_path):
    mesh = define_bumps(tmp_path)
    points = np.array(mesh.GetPointsAttr().Get())
    # Bent, and the same way round where seen from above; the lower half is turned over in the input itself.
    bent = points[:, :2] + 0.05 * np.sin(9 * points[:, [1, 0]])
    define_texture(mesh, bent)
    define_bumps.stage.Save()
    out = simplified(tmp_path, "/Bumps", 0.2)
    index = np.array(out.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    height = np.array(out.GetPointsAttr().Get())[index].mean(axis=1)[:, 2]
    assert (texture_signs(out)[height > 0.2] > 0).all()
    assert (texture_signs(out)[height < -0.2] < 0).all()


def test_texture_seam_stays_on_its_line(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    source = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH))
    points = np.array(source.GetPointsAttr().Get(FRAMES[0]))
    index = np.array(source.GetFaceVertexIndicesAttr().Get())
    first = np.cumsum([0, *source.GetFaceVertexCountsAttr().Get()])[:-1]
    counts = np.array(source.GetFaceVertexCountsAttr().Get())
    middle = np.repeat(np.add.reduceat(points[index, 0], first) / counts, counts)
    line = np.sort(np.unique(points[:, 0]))[len(np.unique(points[:, 0])) // 2]
    right = middle > line
    # Two islands, far apart, that meet at x = line.
    values = points[index, :2] + np.where(right, 100.0, 0.0)[:, None] * [1, 0]
    define_texture(source, values, "faceVarying")
    stage.Save()
    mesh = simplified(tmp_path, CLOTH, 0.3)
    found = np.array(UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st").ComputeFlattened())
    assert found[found[:, 0] < 60, 0].max() == pytest.approx(line, abs=1e-4)
    assert found[found[:, 0] > 60, 0].min() == pytest.approx(line + 100, abs=1e-4)


def test_colors_stay_in_the_range_of_the_input(tmp_path):
    mesh = define_bumps(tmp_path)
    points = np.array(mesh.GetPointsAttr().Get())
    mesh.CreateDisplayColorPrimvar("vertex").Set(
        Vt.Vec3fArray.FromNumpy(np.where(points[:, :1] > 0, np.float32([[1, 0.5, 0]]), np.float32([[0, 0.5, 1]])))
    )
    define_bumps.stage.Save()
    colors = np.array(simplified(tmp_path, "/Bumps", 0.2).GetDisplayColorPrimvar().Get())
    assert colors.min() >= 0
    assert colors.max() <= 1
    assert (colors[:, 1] == 0.5).all()


def test_infinite_weights_are_left_as_they_were_transferred(tmp_path):
    mesh = define_bumps(tmp_path)
    weights = np.ones(len(mesh.GetPointsAttr().Get()), dtype=np.float32)
    weights[:3] = np.inf
    UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("keep", NAMES.FloatArray, "vertex").Set(Vt.FloatArray.FromNumpy(weights))
    define_bumps.stage.Save()
    found = np.array(UsdGeom.PrimvarsAPI(simplified(tmp_path, "/Bumps", 0.3)).GetPrimvar("keep").Get())
    assert not np.isnan(found).any()


def test_normal_offsets_of_blend_shapes_are_fitted_with_the_normals(tmp_path):
    stage = skinned_stage(tmp_path / "in.usda")
    source = UsdGeom.Mesh(stage.GetPrimAtPath(BODY))
    points = np.array(source.GetPointsAttr().Get())
    source.CreateNormalsAttr([Gf.Vec3f(0, 0, 1)] * len(points))
    source.SetNormalsInterpolation("vertex")
    shapes = [prim for prim in stage.Traverse() if prim.IsA(UsdSkel.BlendShape)]
    for prim in shapes:
        shape = UsdSkel.BlendShape(prim)
        moved = shape.GetPointIndicesAttr().Get() or range(len(points))
        shape.CreateNormalOffsetsAttr([Gf.Vec3f(0.25, 0, 0)] * len(list(moved)))
    stage.Save()
    simplified(tmp_path, BODY, 0.4)
    assert shapes
    for prim in shapes:
        offsets = np.array(
            UsdSkel.BlendShape(simplified.stage.GetPrimAtPath(prim.GetPath())).GetNormalOffsetsAttr().Get()
        )
        assert (np.abs(offsets[:, 0]) <= 0.25).all()
        assert (offsets[:, 1:] == 0).all()


@pytest.mark.parametrize(("count", "most", "chosen"), [(3, 5, [0, 1, 2]), (9, 3, [0, 4, 8]), (1, 1, [0])])
def test_chosen_items_are_spread_with_the_ends(count, most, chosen):
    assert spread(range(count), most) == chosen


def test_normals_of_a_rest_shape_in_other_units_are_fitted(tmp_path):
    stage = skinned_stage(tmp_path / "in.usda")
    source = UsdGeom.Mesh(stage.GetPrimAtPath(BODY))
    source.GetSubdivisionSchemeAttr().Set("catmullClark")
    points = np.array(source.GetPointsAttr().Get())
    source.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(points * np.float32(0.01)))
    binding = UsdSkel.BindingAPI(source)
    bind = binding.GetGeomBindTransformAttr().Get() or Gf.Matrix4d(1)
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d().SetScale(100) * bind)
    stage.Save()
    mesh = simplified(tmp_path, BODY, 0.4)
    index = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    own = vertex_normals(np.array(mesh.GetPointsAttr().Get()), index)[index]
    # Fitted, and not far from those of the faces.
    cosine = (corner_normals(mesh) * own).sum(axis=2)
    assert (cosine > 0.5).all()
    assert (cosine < 1 - 1e-6).any()


def test_texture_coordinates_fit_all_frames(tmp_path, monkeypatch):
    scene, frames = SCENES / "cape_wind.usdc", FrameRange(1, 17)
    found = []
    for count in (8, 1):
        monkeypatch.setattr(attribute_transfer, "MAX_FRAMES", count)
        options = SimplifyOptions(ratio=0.1, frames=frames, measure=False, device="cpu")
        simplify_stage(scene, tmp_path / f"{count}.usdc", options)
        stages = (Usd.Stage.Open(str(path)) for path in (scene, tmp_path / f"{count}.usdc"))
        found.append(stage_looks(*stages, "/Cape/Mesh", frames, "cpu").uvs["st"].error)
    assert found[0] < 0.9 * found[1]
