"""Blend shapes of the simplified mesh."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdSkel

from tests.support.usd_blend_shapes import BODY, SHAPE, shaped_stage
from tests.support.usd_stages import define_cloth, skinned_stage
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.read.blend_shapes import MAX_TARGETS, ShapeData, choose_targets


def simplified(folder: Path, **options: object) -> tuple[Usd.Stage, list[str]]:
    report = simplify_stage(
        folder / "in.usda", folder / "out.usda", SimplifyOptions(**{"ratio": 0.4, "device": "cpu", **options})
    )
    dropped = next(prim.dropped for prim in report.prims if prim.path == BODY)
    return Usd.Stage.Open(str(folder / "out.usda")), dropped


def dense_offsets(stage: Usd.Stage, attribute: str) -> tuple[np.ndarray, np.ndarray]:
    """Rest points and the offsets of an attribute of the shape at each of them."""
    points = np.array(UsdGeom.Mesh(stage.GetPrimAtPath(BODY)).GetPointsAttr().Get())
    shape = stage.GetPrimAtPath(SHAPE)
    offsets = np.zeros_like(points)
    offsets[np.array(shape.GetAttribute("pointIndices").Get())] = np.array(shape.GetAttribute(attribute).Get())
    return points, offsets


@pytest.mark.parametrize(("attribute", "factor"), [("offsets", 1.0), ("normalOffsets", 0.1), ("inbetweens:half", 0.7)])
def test_offsets_follow_the_surface(tmp_path, flatten, attribute, factor):
    shaped_stage(tmp_path)
    stage, dropped = simplified(tmp_path, flatten=flatten)
    points, offsets = dense_offsets(stage, attribute)
    assert dropped == []
    # Up to the distance of a new vertex from the surface, and across the fold at x = 4 that of an old edge.
    np.testing.assert_allclose(offsets[:, 2], factor * np.maximum(0, 4 - points[:, 0]), atol=0.5)


def test_points_that_a_shape_does_not_move_are_left_out(tmp_path):
    shaped_stage(tmp_path)
    stage, _ = simplified(tmp_path)
    points, offsets = dense_offsets(stage, "offsets")
    indices = np.array(stage.GetPrimAtPath(SHAPE).GetAttribute("pointIndices").Get())
    assert 0 < len(indices) < len(points)
    assert (np.abs(offsets[indices]).max(axis=1) > 0).all()


def test_shape_without_any_offset_left_moves_nothing(tmp_path):
    stage = shaped_stage(tmp_path)
    shape = UsdSkel.BlendShape(stage.GetPrimAtPath(SHAPE))
    for attribute in (shape.GetOffsetsAttr(), shape.GetNormalOffsetsAttr(), shape.GetInbetween("half").GetAttr()):
        attribute.Set([Gf.Vec3f(0)] * 81)
    stage.Save()
    result, _ = simplified(tmp_path)
    # No index at all would mean an offset for every point.
    assert len(result.GetPrimAtPath(SHAPE).GetAttribute("pointIndices").Get()) == 1
    assert not dense_offsets(result, "offsets")[1].any()


def test_shape_of_two_meshes_is_baked_and_says_why(tmp_path):
    stage = shaped_stage(tmp_path)
    other = UsdSkel.BindingAPI.Apply(define_cloth(stage, "/Char/Other").GetPrim())
    other.CreateBlendShapesAttr(["bulge"])
    other.CreateBlendShapeTargetsRel().SetTargets([SHAPE])
    stage.Save()
    result, dropped = simplified(tmp_path)
    assert dropped == [f"skin binding with 1 blend shape (blend shape {SHAPE} belongs to 2 meshes)"]
    assert len(UsdGeom.Mesh(result.GetPrimAtPath(BODY)).GetPointsAttr().GetTimeSamples()) == 3


def test_baking_leaves_a_shape_to_the_other_mesh_that_uses_it(tmp_path, flatten):
    stage = shaped_stage(tmp_path)
    other = UsdSkel.BindingAPI.Apply(define_cloth(stage, "/Char/Other").GetPrim())
    other.CreateBlendShapesAttr(["bulge"])
    other.CreateBlendShapeTargetsRel().SetTargets([SHAPE])
    stage.Save()
    result, _ = simplified(tmp_path, bake=True, prims=(BODY,), flatten=flatten)
    assert len(UsdSkel.BlendShape(result.GetPrimAtPath(SHAPE)).GetOffsetsAttr().Get()) == 81


def test_shape_without_an_animation_takes_part_in_simplification(tmp_path):
    stage = skinned_stage(tmp_path / "in.usda")
    stage.RemovePrim("/Char/Rig/Anim")
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(BODY))
    points = np.array(mesh.GetPointsAttr().Get())
    mesh.GetPointsAttr().Set([Gf.Vec3f(float(x), float(y), 0) for x, y, _ in points])
    shape = UsdSkel.BlendShape(stage.GetPrimAtPath(SHAPE))
    # A ridge that the flat rest shape does not show.
    ridge = [Gf.Vec3f(0, 0, 3) if x == 6 else Gf.Vec3f(0) for x in points[:, 0]]
    shape.GetPointIndicesAttr().Set([])
    shape.GetOffsetsAttr().Set(ridge)
    shape.GetInbetween("half").SetOffsets(ridge)
    stage.Save()
    result, _ = simplified(tmp_path)
    rest, offsets = dense_offsets(result, "offsets")
    near = rest[offsets[:, 2] > 2.5]
    assert len(near)
    np.testing.assert_allclose(near[:, 0], 6, atol=0.2)


def test_chosen_targets_are_far_apart():
    shapes = [ShapeData("", {"offsets": np.full((1, 3), value, dtype=np.float32)}) for value in np.arange(1.0, 51.0)]
    values = [float(offsets[0, 0]) for offsets in choose_targets(shapes)]
    assert len(values) == MAX_TARGETS
    assert values[-1] == 50.0
    # 24 of the values 1 to 50 and the neutral 0 are at least 1 apart, and no gap is larger than 4.
    assert max(np.diff([0.0, *values])) <= 4.0
