"""Skinned meshes that stay skinned."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel

from tests.support.usd_skin_output import BODY, rms
from tests.support.usd_stages import FRAMES, skinned_stage
from warpqem.mesh.smooth_normals import vertex_normals
from warpqem.pipeline.surface_transfer import surface_transfer
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.read.mesh_skin import Influences
from warpqem.usd.write.attribute_transfer import Rows
from warpqem.usd.write.skin_output import blend_influences


def simplified(folder: Path, **options: object) -> tuple[Usd.Stage, list[str]]:
    report = simplify_stage(
        folder / "in.usda", folder / "out.usda", SimplifyOptions(**{"ratio": 0.4, "device": "cpu", **options})
    )
    assert [prim.status for prim in report.prims] == ["simplified"]
    return Usd.Stage.Open(str(folder / "out.usda")), report.prims[0].dropped


@pytest.mark.parametrize("method", ["classicLinear", "dualQuaternion"])
def test_skinned_output_is_as_near_as_the_baked_one(tmp_path, method):
    source = skinned_stage(tmp_path / "in.usda")
    UsdSkel.BindingAPI(source.GetPrimAtPath(BODY)).CreateSkinningMethodAttr(method)
    source.Save()
    skinned, dropped = simplified(tmp_path)
    assert dropped == []
    error = rms(source, skinned)
    baked, _ = simplified(tmp_path, bake=True)
    # The bound that the project sets itself; a skin has fewer degrees of freedom than free points.
    assert error <= 1.3 * rms(source, Usd.Stage.Open(baked.Flatten()))


def test_rest_shape_is_one_set_of_points(tmp_path, flatten):
    skinned_stage(tmp_path / "in.usda")
    stage, _ = simplified(tmp_path, flatten=flatten)
    points = UsdGeom.Mesh(stage.GetPrimAtPath(BODY)).GetPointsAttr()
    assert points.GetTimeSamples() == []
    # The waving cloth at rest spans its 8 x 8 quads, wherever the skeleton takes it.
    assert np.abs(np.ptp(np.array(points.Get())[:, :2], axis=0) - 8).max() < 0.5


def test_rest_samples_of_the_input_are_hidden(tmp_path):
    source = skinned_stage(tmp_path / "in.usda")
    points = UsdGeom.Mesh(source.GetPrimAtPath(BODY)).GetPointsAttr()
    value = points.Get()
    points.Clear()
    points.Set(value, 1.0)
    source.Save()
    stage, _ = simplified(tmp_path)
    result = UsdGeom.Mesh(stage.GetPrimAtPath(BODY)).GetPointsAttr()
    assert len(result.Get(1.0)) == len(result.Get()) < 81


def test_binding_to_the_skeleton_stays(tmp_path, flatten):
    source = skinned_stage(tmp_path / "in.usda")
    stage, _ = simplified(tmp_path, flatten=flatten)
    before, after = (UsdSkel.BindingAPI(item.GetPrimAtPath(BODY)) for item in (source, stage))
    assert after.GetSkeletonRel().GetTargets() == before.GetSkeletonRel().GetTargets()
    assert after.GetGeomBindTransformAttr().Get() == before.GetGeomBindTransformAttr().Get()


def test_weights_sum_to_one_at_every_vertex(tmp_path):
    skinned_stage(tmp_path / "in.usda")
    stage, _ = simplified(tmp_path)
    binding = UsdSkel.BindingAPI(stage.GetPrimAtPath(BODY))
    weights = np.array(binding.GetJointWeightsPrimvar().Get()).reshape(-1, 2)
    assert binding.GetJointWeightsPrimvar().GetElementSize() == 2
    assert len(weights) == len(UsdGeom.Mesh(stage.GetPrimAtPath(BODY)).GetPointsAttr().Get())
    assert (weights >= 0).all()
    np.testing.assert_array_equal(weights.sum(axis=1, dtype=np.float32), 1.0)


def test_joint_that_moves_the_whole_mesh_stays_as_it_is(tmp_path):
    source = skinned_stage(tmp_path / "in.usda", rigid=True)
    stage, dropped = simplified(tmp_path)
    indices = UsdSkel.BindingAPI(stage.GetPrimAtPath(BODY)).GetJointIndicesPrimvar()
    assert (indices.GetInterpolation(), list(indices.Get()), dropped) == ("constant", [1], [])
    baked, _ = simplified(tmp_path, bake=True)
    assert rms(source, Usd.Stage.Open(str(tmp_path / "in.usda"))) < 1e-5 < rms(source, baked)


def test_influences_inherited_from_an_ancestor_become_the_meshs_own(tmp_path):
    source = skinned_stage(tmp_path / "in.usda")
    body, group = (UsdSkel.BindingAPI.Apply(source.GetPrimAtPath(path)) for path in (BODY, "/Char"))
    for name in ("JointIndices", "JointWeights"):
        own = getattr(body, f"Get{name}Primvar")()
        getattr(group, f"Create{name}Primvar")(False, 2).Set(own.Get())
        source.GetPrimAtPath(BODY).RemoveProperty(own.GetName())
    source.Save()
    stage, _ = simplified(tmp_path)
    weights = UsdSkel.BindingAPI(stage.GetPrimAtPath(BODY)).GetJointWeightsPrimvar()
    assert len(weights.Get()) == 2 * len(UsdGeom.Mesh(stage.GetPrimAtPath(BODY)).GetPointsAttr().Get())
    # Read back by UsdSkel, the mesh is near the input.
    assert rms(source, stage) < 2.0


def test_bake_option_writes_point_samples(tmp_path):
    skinned_stage(tmp_path / "in.usda")
    stage, dropped = simplified(tmp_path, bake=True)
    assert UsdGeom.Mesh(stage.GetPrimAtPath(BODY)).GetPointsAttr().GetTimeSamples() == FRAMES
    # What was asked for is no loss.
    assert dropped == []


def test_normals_of_the_rest_shape_are_transferred(tmp_path):
    source = skinned_stage(tmp_path / "in.usda")
    UsdGeom.Mesh(source.GetPrimAtPath(BODY)).CreateNormalsAttr([Gf.Vec3f(0, 0, 1)] * 81)
    source.Save()
    stage, dropped = simplified(tmp_path)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(BODY))
    assert dropped == []
    assert len(mesh.GetNormalsAttr().Get()) == len(mesh.GetPointsAttr().Get())


@pytest.mark.parametrize("name", ["normals", "primvars:normals"])
def test_normals_of_the_rest_shape_are_made_anew_for_poses(tmp_path, flatten, name):
    source = skinned_stage(tmp_path / "in.usda")
    body = source.GetPrimAtPath(BODY)
    if name == "normals":
        UsdGeom.Mesh(body).CreateNormalsAttr([Gf.Vec3f(0, 0, 1)] * 81)
    else:
        primvar = UsdGeom.PrimvarsAPI(body).CreatePrimvar("normals", Sdf.ValueTypeNames.Normal3fArray, "vertex")
        primvar.Set([Gf.Vec3f(0, 0, 1)] * 81)
    source.Save()
    stage, dropped = simplified(tmp_path, bake=True, flatten=flatten, normals="keep")
    assert f"{name} of the rest pose (made anew from the poses)" in dropped
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(BODY))
    assert (mesh.GetNormalsInterpolation(), mesh.GetNormalsAttr().GetTimeSamples()) == ("vertex", FRAMES)
    assert not mesh.GetPrim().GetAttribute("primvars:normals").HasAuthoredValue()
    faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    for time in FRAMES:
        points = np.array(mesh.GetPointsAttr().Get(time))
        np.testing.assert_allclose(mesh.GetNormalsAttr().Get(time), vertex_normals(points, faces), atol=1e-6)


def test_hard_edges_of_the_rest_shape_are_hard_in_poses(tmp_path, flatten):
    source = skinned_stage(tmp_path / "in.usda")
    mesh = UsdGeom.Mesh(source.GetPrimAtPath(BODY))
    # Half of the faces turned away, so that there is one hard edge across the middle.
    indices = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 4)
    points = np.array(mesh.GetPointsAttr().Get())
    left = points[indices, 0].mean(axis=1) < points[:, 0].mean()
    normals = np.where(left[:, None, None], [[[0.0, 0.0, 1.0]]], [[[1.0, 0.0, 0.0]]])
    mesh.CreateNormalsAttr(np.repeat(normals, 4, axis=1).reshape(-1, 3).astype(np.float32))
    mesh.SetNormalsInterpolation("faceVarying")
    source.Save()
    stage, _ = simplified(tmp_path, bake=True, flatten=flatten)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(BODY))
    assert mesh.GetNormalsInterpolation() == "faceVarying"
    faces = np.array(mesh.GetFaceVertexIndicesAttr().Get())
    normals = np.array(mesh.GetNormalsAttr().Get(FRAMES[-1]))
    assert len(normals) == len(faces)
    counts = [len(np.unique(normals[faces == vertex].round(5), axis=0)) for vertex in np.unique(faces)]
    # A vertex of the edge has two normals, all others one.
    assert max(counts) == 2
    assert 1 <= counts.count(2) <= len(counts) / 3


def test_mesh_whose_rest_points_move_is_baked_and_says_why(tmp_path):
    source = skinned_stage(tmp_path / "in.usda")
    points = UsdGeom.Mesh(source.GetPrimAtPath(BODY)).GetPointsAttr()
    value = np.array(points.Get())
    points.Set([Gf.Vec3f(*map(float, point)) for point in value], 1.0)
    points.Set([Gf.Vec3f(*map(float, point)) for point in value * 1.1], 2.0)
    source.Save()
    stage, dropped = simplified(tmp_path)
    assert dropped == ["skin binding with 1 blend shape (its rest points are animated)"]
    assert UsdGeom.Mesh(stage.GetPrimAtPath(BODY)).GetPointsAttr().GetTimeSamples() == FRAMES


def test_rest_shape_in_other_units_than_the_skeleton_counts_the_same(tmp_path):
    source = skinned_stage(tmp_path / "in.usda")
    mesh = UsdGeom.Mesh(source.GetPrimAtPath(BODY))
    mesh.GetPointsAttr().Set([Gf.Vec3f(point * 1000) for point in mesh.GetPointsAttr().Get()])
    binding = UsdSkel.BindingAPI(mesh.GetPrim())
    bind = Gf.Matrix4d().SetScale(0.001) * binding.GetGeomBindTransformAttr().Get()
    binding.GetGeomBindTransformAttr().Set(bind)
    source.Save()
    stage, _ = simplified(tmp_path)
    error = rms(source, stage)
    baked, _ = simplified(tmp_path, bake=True)
    assert error <= 1.3 * rms(source, baked)


def test_influences_are_the_largest_of_the_weighted_mean():
    influences = Influences(
        np.array([[0, 1], [1, 2], [3, 3]], dtype=np.int32),
        np.array([[0.5, 0.5], [0.9, 0.1], [1.0, 0.0]], dtype=np.float32),
    )
    rows = Rows(np.array([[0, 1, 2]]), np.array([[0.5, 0.5, 0.0]], dtype=np.float32))
    blended = blend_influences(influences, rows)
    # Dense: joint 0 0.25, joint 1 0.70, joint 2 0.05, joint 3 0; the two largest, scaled to sum one.
    assert blended.joints.tolist() == [[1, 0]]
    np.testing.assert_allclose(blended.weights, [[0.70 / 0.95, 0.25 / 0.95]], rtol=1e-6)


@pytest.mark.parametrize("options", [{}, {"ratio": None, "lods": (0.5, 0.3)}], ids=["one", "levels"])
def test_skin_is_fitted_and_written_by_one_search_of_the_surface(tmp_path, monkeypatch, options):
    searches = []

    def counted(points, faces, result, **given):
        searches.append((id(result), np.asarray(given["seams"]).tobytes(), result))
        return surface_transfer(points, faces, result, **given)

    monkeypatch.setattr("warpqem.usd.write.attribute_transfer.surface_transfer", counted)
    skinned_stage(tmp_path / "in.usda")
    chosen = SimplifyOptions(**{"ratio": 0.4, "device": "cpu", **options})
    simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", chosen)
    keys = [search[:2] for search in searches]
    assert len(keys) == len(set(keys)) >= len(options.get("lods", (0.4,)))
