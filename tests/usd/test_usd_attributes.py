"""Weights of primvars."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom

from tests.support.usd_stages import cloth_stage, define_cloth
from warpqem.errors import OptionError
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.commands.attributes import weighted_fields
from warpqem.usd.commands.option_checks import parse_attribute_weight, parse_faces
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.skeleton_poses import StagePoses

TYPES = Sdf.ValueTypeNames
SIZE = 16
LINE = 7


def define_primvar(stage: Usd.Stage, name: str, kind: Sdf.ValueTypeName, interpolation: str, value: object) -> None:
    api = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/Root/Cloth"))
    api.CreatePrimvar(name, kind, interpolation).Set(value)


def fields_of(stage: Usd.Stage, uv_weight: float, weights=()) -> dict[tuple[int, ...], float]:
    """Weights by the shape of the values."""
    source = MeshSource(stage.GetPrimAtPath("/Root/Cloth"), StagePoses(stage))
    return {field.values.shape: field.weight for field in weighted_fields(source, uv_weight, weights)}


@pytest.fixture
def stage() -> Usd.Stage:
    return cloth_stage(size=2, times=None)


@pytest.mark.parametrize(
    ("name", "kind"), [("st", TYPES.TexCoord2fArray), ("albedo", TYPES.TexCoord2hArray), ("uv_1", TYPES.Float2Array)]
)
def test_texture_coordinates_are_found_by_role_or_name(name, kind, stage):
    define_primvar(stage, name, kind, "vertex", [(0, 0)] * 9)
    assert fields_of(stage, 0.5) == {(8, 3, 2): 0.5}


def test_other_pairs_of_numbers_are_no_texture_coordinates(stage):
    define_primvar(stage, "wind", TYPES.Float2Array, "vertex", [(0, 0)] * 9)
    assert fields_of(stage, 0.5) == {}


def test_named_weight_takes_the_place_of_that_of_texture_coordinates(stage):
    define_primvar(stage, "st", TYPES.TexCoord2fArray, "vertex", [(0, 0)] * 9)
    define_primvar(stage, "displayColor", TYPES.Color3fArray, "faceVarying", [(0, 0, 0)] * 16)
    weights = [("st", 0.0), ("primvars:displayColor", 2.0)]
    assert fields_of(stage, 0.5, weights) == {(8, 3, 3): 2.0}


def test_constant_primvar_is_left_out(stage):
    define_primvar(stage, "displayColor", TYPES.Color3fArray, "constant", [(1, 0, 0)])
    assert fields_of(stage, 0.5, [("displayColor", 1.0)]) == {}


def bent_stage(path: Path) -> None:
    """A flat cloth whose faceVarying texture bends at a column of points."""
    stage = cloth_stage(path, size=SIZE, times=None)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth"))
    points = np.array(mesh.GetPointsAttr().Get()) * [1, 1, 0]
    mesh.GetPointsAttr().Set(points)
    x = points[np.array(mesh.GetFaceVertexIndicesAttr().Get())]
    u = np.where(x[:, 0] < LINE, x[:, 0], LINE + 3 * (x[:, 0] - LINE)) / SIZE
    define_primvar(stage, "st", TYPES.TexCoord2fArray, "faceVarying", np.stack([u, x[:, 1] / SIZE], axis=1))
    stage.Save()


@pytest.mark.parametrize("options", [{"uv_weight": 0.1}, {"attribute_weights": (("st", 0.1),)}])
def test_line_where_the_texture_bends_keeps_its_points(options, tmp_path):
    bent_stage(tmp_path / "in.usda")
    count = []
    for given in ({}, options):
        output = tmp_path / f"out{len(count)}.usda"
        report = simplify_stage(tmp_path / "in.usda", output, SimplifyOptions(ratio=0.15, device="cpu", **given))
        result = Usd.Stage.Open(report.output)
        mesh = UsdGeom.Mesh(result.GetPrimAtPath("/Root/Cloth"))
        count.append((np.abs(np.array(mesh.GetPointsAttr().Get())[:, 0] - LINE) < 0.02).sum())
    assert count[1] >= 4 > count[0]


def test_primvar_without_real_numbers_fails_its_mesh(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    define_cloth(stage, "/Root/Other")
    define_primvar(stage, "kind", TYPES.IntArray, "vertex", [1] * 81)
    stage.Save()
    options = SimplifyOptions(ratio=0.5, device="cpu", attribute_weights=(("kind", 1.0),))
    report = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options)
    assert [prim.status for prim in report.prims] == ["failed", "simplified"]
    assert report.prims[0].message.startswith("/Root/Cloth.primvars:kind: has no real numbers")


def test_name_that_no_mesh_has_is_refused(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    options = SimplifyOptions(ratio=0.5, device="cpu", attribute_weights=(("ts", 1.0),))
    with pytest.raises(OptionError, match="none of the 1 meshes has a primvar ts"):
        simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"uv_weight": -1.0}, "uv_weight must be in .0, 1e.06., got -1"),
        ({"uv_weight": float("nan")}, "got nan"),
        ({"attribute_weights": (("st", float("inf")),)}, "attribute_weights of st must be in .*, got inf"),
    ],
)
def test_weight_out_of_range_is_refused(options, message):
    with pytest.raises(OptionError, match=message):
        SimplifyOptions(ratio=0.5, **options)


def test_weight_of_a_name_is_read():
    assert parse_attribute_weight("primvars:a=b=0.5") == ("a=b", 0.5)


@pytest.mark.parametrize("text", ["st", "st=", "=1", "st=much"])
def test_weight_of_a_name_in_another_form_is_refused(text):
    with pytest.raises(OptionError, match="expected NAME=WEIGHT"):
        parse_attribute_weight(text)


@pytest.mark.parametrize(
    ("text", "faces"), [("50", 50), ("+50", 50), ("50.0", 50), ("25 %", "25%"), ("+2.5%", "+2.5%")]
)
def test_a_number_of_faces_is_a_count_or_a_share(text, faces):
    assert parse_faces(text) == faces
