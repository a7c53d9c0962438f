"""Normals that skinned meshes had none of, fitted to the input's shading in the poses that they are shown in."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdSkel

from tests.support.skin_fit import FACES, SKIN
from tests.support.usd_rig import ANIMATION, FRAMES, NAMES, TUBE, rig, shaped_rig
from tests.support.usd_stages import cloth_stage
from warpqem.measure import CornerValues, SurfaceValues, compare_appearance
from warpqem.mesh.directions import unit_vectors
from warpqem.mesh.smooth_normals import vertex_normals
from warpqem.usd import CompareOptions, SimplifyOptions, compare_stage_images, simplify_stage
from warpqem.usd.read.shading_normals import skinned_normals
from warpqem.usd.read.skeleton_poses import StagePoses
from warpqem.usd.write import fitted_normals
from warpqem.usd.write.attribute_transfer import AttributeTransfer
from warpqem.usd.write.normal_poses import NormalPose, shown_poses


def smooth(stage: Usd.Stage) -> None:
    """A subdivision surface, which gets normals however near its own faces' are."""
    UsdGeom.Mesh(stage.GetPrimAtPath(TUBE)).CreateSubdivisionSchemeAttr("catmullClark")
    stage.Save()


def shading(folder: Path, name: str) -> float:
    """PSNR of the shading in three poses."""
    output = folder / f"{name}.usda"
    simplify_stage(folder / "in.usda", output, SimplifyOptions(ratio=0.15, measure=False, device="cpu"))
    [report] = compare_stage_images(folder / "in.usda", output, CompareOptions(device="cpu"), size=64)
    return report.score.shading.psnr


def turn_to_one_side(stage: Usd.Stage) -> None:
    """Joints that are never straight."""
    rotations = UsdSkel.Animation(stage.GetPrimAtPath(ANIMATION)).GetRotationsAttr()
    for number, frame in enumerate(FRAMES):
        turn = Gf.Quatf(Gf.Rotation(Gf.Vec3d(0, 1, 0), 30.0 + number).GetQuat())
        rotations.Set([turn] * len(NAMES), frame)


def test_poses_are_shaded_more_like_the_input_than_by_a_fit_at_rest(tmp_path, monkeypatch):
    stage = rig(tmp_path / "in.usda")
    turn_to_one_side(stage)
    smooth(stage)
    in_poses = shading(tmp_path, "poses")
    monkeypatch.setattr(fitted_normals, "shown_poses", lambda *_: [])
    assert in_poses > shading(tmp_path, "rest") + 0.3


def test_rest_shape_is_no_further_from_the_input_than_with_the_normals_of_its_faces(tmp_path):
    stage = rig(tmp_path / "in.usda")
    turn_to_one_side(stage)
    smooth(stage)
    angles = {}
    for how in ("fit", "keep"):
        options = SimplifyOptions(ratio=0.3, normals=how, measure=False, device="cpu")
        simplify_stage(tmp_path / "in.usda", tmp_path / f"{how}.usda", options)
        angles[how] = rest_angle(tmp_path / f"{how}.usda")
    assert angles["fit"] <= angles["keep"]


def rest_angle(output: Path) -> float:
    """Mean angle at rest between the normals of a tube and those of the smooth input, both ways."""
    stage = Usd.Stage.Open(str(output))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(TUBE))
    points, index = np.array(mesh.GetPointsAttr().Get()), np.array(mesh.GetFaceVertexIndicesAttr().Get())
    normals, rest = np.array(mesh.GetNormalsAttr().Get()), SKIN.rest.astype(np.float32)
    shown = normals[index] if mesh.GetNormalsInterpolation() == "vertex" else normals
    values = [vertex_normals(rest, FACES)[FACES], shown.reshape(-1, 3, 3)]
    one, other = (SurfaceValues(normals=CornerValues.of("normals", value)) for value in values)
    found = compare_appearance(rest, FACES, one, points, index.reshape(-1, 3), other, device="cpu").normals
    assert found is not None
    return found.mean


def test_polygons_that_joints_would_shade_worse_get_none_and_a_note(tmp_path):
    shaped_rig(tmp_path / "in.usda")
    output = tmp_path / "out.usda"
    options = SimplifyOptions(ratio=0.5, normals="fit", measure=False, device="cpu")
    [report] = simplify_stage(tmp_path / "in.usda", output, options).prims
    stage = Usd.Stage.Open(str(output))
    assert not UsdGeom.Mesh(stage.GetPrimAtPath(TUBE)).GetNormalsAttr().HasAuthoredValue()
    assert report.notes == [f"{TUBE}: no normals, as it is shaded more like the input without them"]


@pytest.mark.parametrize("make", [rig, shaped_rig])
def test_turns_are_those_of_usd(make, tmp_path):
    stage = make(tmp_path / "in.usda")
    prim = stage.GetPrimAtPath(TUBE)
    poser, mesh = StagePoses(stage).poser(prim), UsdGeom.Mesh(prim)
    count = len(mesh.GetPointsAttr().Get())
    transfer = AttributeTransfer.__new__(AttributeTransfer)
    transfer.shown_codes = [Usd.TimeCode(time) for time in FRAMES[:2]]
    transfer.read_shown = lambda _: np.zeros((count, 3), dtype=np.float32)
    given = unit_vectors(np.random.default_rng(5).normal(size=(count, 3)))
    vertex = np.arange(count)
    for pose, code in zip(shown_poses(mesh, transfer, poser, [0, 1]), transfer.shown_codes, strict=True):
        expected = unit_vectors(skinned_normals(poser, given, vertex, code))
        np.testing.assert_allclose(pose.turned(given, vertex), expected, atol=1e-5)
        np.testing.assert_allclose(pose.unturned(expected, vertex), given, atol=1e-4)
        np.testing.assert_array_equal(pose.placed, poser.pose(mesh.GetPointsAttr().Get(), code))


def test_joints_that_leave_no_direction_have_no_say():
    nothing = np.zeros((1, 3), dtype=np.float32)
    flat = NormalPose(nothing, nothing, nothing, np.array([np.diag([1.0, 1.0, 0.0])]))
    np.testing.assert_array_equal(flat.unturned(np.array([[0.0, 0.6, 0.8]]), np.zeros(1, dtype=np.int64)), 0.0)


def test_sheets_with_two_sides_on_the_same_points_get_none(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda", times=None)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth"))
    mesh.CreateSubdivisionSchemeAttr("none")
    index = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 4)
    mesh.GetFaceVertexIndicesAttr().Set(np.concatenate([index, index[:, ::-1]]).ravel().tolist())
    mesh.GetFaceVertexCountsAttr().Set([4] * (2 * len(index)))
    for primvar in UsdGeom.PrimvarsAPI(mesh).GetPrimvars():
        mesh.GetPrim().RemoveProperty(primvar.GetName())
    stage.Save()
    options = SimplifyOptions(ratio=0.3, normals="fit", measure=False, device="cpu")
    [report] = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options).prims
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    assert report.status == "simplified"
    assert not UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth")).GetNormalsAttr().HasAuthoredValue()
