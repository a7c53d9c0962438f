"""Importance painted on meshes."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom

import warpqem
from tests.support.usd_stages import cloth_stage, define_cloth
from warpqem.errors import OptionError
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.commands.blend_shape_weights import morph_scale
from warpqem.usd.commands.mesh_job import MeshJob
from warpqem.usd.commands.simplify_options import WeightScales
from warpqem.usd.commands.weights import painted_weights
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.skeleton_poses import StagePoses

CLOTH = "/Root/Cloth"
NAME = "importance"
SIZE = 8
TIMES = [1.0, 2.0, 3.0]


def paint(stage: Usd.Stage, values: object, interpolation: str = "vertex", path: str = CLOTH) -> UsdGeom.Primvar:
    api = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath(path))
    primvar = api.CreatePrimvar("importance", Sdf.ValueTypeNames.FloatArray, interpolation)
    primvar.Set(values)
    return primvar


def weights_of(stage: Usd.Stage) -> np.ndarray | None:
    job = MeshJob.prepare(MeshSource(stage.GetPrimAtPath(CLOTH), StagePoses(stage)))
    return painted_weights(job, "importance")


def simplified(folder: Path, **options: object) -> tuple[np.ndarray, list[str | None]]:
    """Points of the cloth at the first time, and the messages of the report."""
    options = {"ratio": 0.3, "weight_primvar": "importance", "device": "cpu", **options}
    report = simplify_stage(folder / "in.usda", folder / "out.usda", SimplifyOptions(**options))
    stage = Usd.Stage.Open(str(folder / "out.usda"))
    points = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)).GetPointsAttr()
    return np.array(points.Get(TIMES[0])), [prim.message for prim in report.prims]


def test_value_of_each_point_is_its_weight():
    stage = cloth_stage(size=SIZE, times=TIMES)
    values = np.arange(81, dtype=np.float32)
    paint(stage, values)
    np.testing.assert_array_equal(weights_of(stage), values)


@pytest.mark.parametrize("interpolation", ["uniform", "faceVarying"])
def test_point_gets_the_largest_value_of_its_faces_or_corners(interpolation):
    stage = cloth_stage(size=SIZE, times=TIMES)
    values = np.ones(64 if interpolation == "uniform" else 256, dtype=np.float32)
    values[0 if interpolation == "uniform" else slice(0, 4)] = 5
    paint(stage, values, interpolation)
    face = np.array(UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)).GetFaceVertexIndicesAttr().Get())[:4]
    weights = weights_of(stage)
    assert sorted(face) == list(np.flatnonzero(weights == 5))
    assert (np.delete(weights, face) == 1).all()


def test_constant_weight_is_inherited_from_a_group():
    stage = cloth_stage(size=SIZE, times=TIMES)
    paint(stage, [4.0], "constant", "/Root")
    assert (weights_of(stage) == 4).all()


def test_largest_of_all_samples_counts():
    stage = cloth_stage(size=SIZE, times=TIMES)
    primvar = paint(stage, [1.0] * 81)
    primvar.Set([2.0] * 81, 1.0)
    primvar.Set([3.0] + [0.0] * 80, 2.0)
    assert weights_of(stage).tolist() == [3.0] + [2.0] * 80


@pytest.mark.parametrize("scales", get_args(WeightScales))
def test_painted_half_keeps_more_points(scales, tmp_path):
    stage = cloth_stage(tmp_path / "in.usda", size=SIZE, times=TIMES)
    x = np.array(UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)).GetPointsAttr().Get(TIMES[0]))[:, 0]
    paint(stage, np.where(x < 4, 100.0, 1.0).astype(np.float32))
    stage.Save()
    points, _ = simplified(tmp_path, weight_scales=scales)
    plain, _ = simplified(tmp_path, weight_primvar=None)
    assert (points[:, 0] < 4).sum() > 1.2 * (plain[:, 0] < 4).sum()


@pytest.mark.parametrize("scales", get_args(WeightScales))
def test_points_with_infinite_weight_stay(scales, tmp_path):
    stage = cloth_stage(tmp_path / "in.usda", size=SIZE, times=TIMES)
    before = np.array(UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)).GetPointsAttr().Get(TIMES[0]))
    values = np.ones(81, dtype=np.float32)
    values[[30, 40]] = np.inf
    paint(stage, values)
    stage.Save()
    points, _ = simplified(tmp_path, weight_scales=scales)
    assert all((points == point).all(axis=1).any() for point in before[[30, 40]])


def bumpy_stage(path: Path) -> Usd.Stage:
    """A cloth whose planes meet nowhere in a point, with weights painted on it."""
    stage = cloth_stage(path, size=SIZE, times=TIMES)
    attribute = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)).GetPointsAttr()
    noise = np.random.default_rng(5).normal(scale=0.3, size=(81, 3))
    for time in TIMES:
        attribute.Set(np.array(attribute.Get(time)) + noise.astype(np.float32), time)
    paint(stage, np.linspace(1, 20, 81, dtype=np.float32))
    stage.Save()
    return stage


@pytest.mark.parametrize(
    ("scales", "option"), [("cost", "vertex_weights"), ("quadrics", "quadric_scale")], ids=["cost", "quadrics"]
)
def test_painted_weights_scale_what_is_asked_for(scales, option, tmp_path):
    stage = bumpy_stage(tmp_path / "in.usda")
    job = MeshJob.prepare(MeshSource(stage.GetPrimAtPath(CLOTH), StagePoses(stage)))
    expected = warpqem.simplify(job.frames, job.faces, ratio=0.3, device="cpu", **{option: painted_weights(job, NAME)})
    points, _ = simplified(tmp_path, weight_scales=scales)
    np.testing.assert_array_equal(points, expected.points[0])
    other, _ = simplified(tmp_path, weight_scales="cost" if scales == "quadrics" else "quadrics")
    assert not np.array_equal(points, other)


def test_painted_quadrics_and_morph_weights_multiply(tmp_path):
    stage = bumpy_stage(tmp_path / "in.usda")
    job = MeshJob.prepare(MeshSource(stage.GetPrimAtPath(CLOTH), StagePoses(stage)))
    scale = painted_weights(job, NAME) * morph_scale(job, "thirds")
    expected = warpqem.simplify(job.frames, job.faces, ratio=0.3, device="cpu", quadric_scale=scale)
    points, _ = simplified(tmp_path, weight_scales="quadrics", morph_weights="thirds")
    np.testing.assert_array_equal(points, expected.points[0])


def test_weights_that_scale_something_else_are_refused():
    with pytest.raises(OptionError, match="weight_scales must be 'cost' or 'quadrics', got 'area'"):
        SimplifyOptions(ratio=0.5, weight_scales="area")


def test_borders_stay_where_asked_for(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda", size=SIZE, times=TIMES)
    before = np.array(UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)).GetPointsAttr().Get(TIMES[0]))
    points, _ = simplified(tmp_path, weight_primvar=None, lock_borders=True)
    border = before[(before[:, :2] == 0).any(axis=1) | (before[:, :2] == SIZE).any(axis=1)]
    assert len(border) == 4 * SIZE
    assert all((points == point).all(axis=1).any() for point in border)


@pytest.mark.parametrize(
    ("value", "interpolation", "message"),
    [
        ([1.0] * 40 + [-2.0] + [1.0] * 40, "vertex", "value 40 is -2; a weight is a number"),
        ([1.0] * 40 + [float("nan")] + [1.0] * 40, "vertex", "value 40 is nan"),
        ([1.0] * 7, "vertex", "7 values of type float[], expected a number for each of 81 elements"),
        ([1.0] * 7, "uniform", "expected a number for each of 64 elements"),
    ],
)
def test_wrong_values_are_named_with_prim_and_attribute(tmp_path, value, interpolation, message):
    stage = cloth_stage(tmp_path / "in.usda", size=SIZE, times=TIMES)
    define_cloth(stage, "/Root/Other", times=TIMES)
    paint(stage, value, interpolation)
    stage.Save()
    _, messages = simplified(tmp_path)
    assert messages[1] is None
    assert messages[0].startswith(f"{CLOTH}.primvars:importance: ")
    assert message in messages[0]


def test_primvar_that_no_mesh_has_is_refused(tmp_path):
    cloth_stage(tmp_path / "in.usda", size=SIZE, times=TIMES)
    with pytest.raises(OptionError, match="none of the 1 meshes has a primvar importance"):
        simplified(tmp_path)
