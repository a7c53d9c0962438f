"""Attributes of other types and layouts than their schema's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from tests.support.usd_stages import cloth_stage
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.read.blend_shapes import ShapeData
from warpqem.usd.write.attribute_transfer import Rows
from warpqem.usd.write.blend_shape_output import write_shape
from warpqem.usd.write.stage_report import PrimReport

NAMES = Sdf.ValueTypeNames
SIZE = 6
CLOTH = "/Root/Cloth"


def cloth() -> UsdGeom.Mesh:
    stage = cloth_stage(size=SIZE, times=None)
    # A prim does not keep its stage alive.
    KEPT.append(stage)
    return UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH))


KEPT: list[Usd.Stage] = []


def retype(mesh: UsdGeom.Mesh, name: str, kind: Sdf.ValueTypeName, value: object) -> None:
    """Author an attribute of the schema as a file does that declares it as something else."""
    spec = mesh.GetPrim().GetStage().GetRootLayer().GetPrimAtPath(CLOTH)
    if name in spec.properties:
        spec.RemoveProperty(spec.properties[name])
    Sdf.AttributeSpec(spec, name, kind).default = value


def simplified(tmp_path: Path, mesh: UsdGeom.Mesh) -> tuple[UsdGeom.Mesh, PrimReport]:
    mesh.GetPrim().GetStage().GetRootLayer().Export(str(tmp_path / "in.usda"))
    report = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(ratio=0.4))
    assert report.prims[0].status == "simplified"
    KEPT.append(Usd.Stage.Open(str(tmp_path / "out.usda")))
    return UsdGeom.Mesh(KEPT[-1].GetPrimAtPath(CLOTH)), report.prims[0]


@pytest.mark.parametrize(
    ("name", "kind", "value"),
    [
        ("normals", NAMES.Double3Array, [Gf.Vec3d(0, 0, 1)] * 49),
        ("normals", NAMES.Int3Array, [Gf.Vec3i(0, 0, 1)] * 49),
        ("velocities", NAMES.Half3Array, [Gf.Vec3h(0, 0, 1)] * 49),
        ("faceVertexCounts", NAMES.UIntArray, [4] * 36),
        ("extent", NAMES.Double3Array, [Gf.Vec3d(0), Gf.Vec3d(6)]),
    ],
)
def test_attribute_of_another_type_is_read_written_as_the_schemas_and_noted(tmp_path, name, kind, value):
    mesh = cloth()
    declared = mesh.GetPrim().GetAttribute(name).GetTypeName()
    retype(mesh, name, kind, value)
    after, report = simplified(tmp_path, mesh)
    result = after.GetPrim().GetAttribute(name)
    assert result.Get() is not None
    assert type(result.Get()) is type(declared.defaultValue)
    assert report.problems == [f"{CLOTH}.{name}: {kind} in the file, taken as {declared}"]


def test_values_that_are_indexed_and_sampled_are_transferred(tmp_path):
    mesh = cloth()
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", NAMES.TexCoord2fArray, "faceVarying")
    points = np.array(mesh.GetPointsAttr().Get())
    for time in (1.0, 2.0):
        primvar.Set(Vt.Vec2fArray.FromNumpy(points[:, :2] + np.float32(time)), time)
    primvar.SetIndices(mesh.GetFaceVertexIndicesAttr().Get())
    after, report = simplified(tmp_path, mesh)
    transferred = UsdGeom.PrimvarsAPI(after).GetPrimvar("st")
    corners = np.array(after.GetPointsAttr().Get())[np.array(after.GetFaceVertexIndicesAttr().Get())]
    for time in (1.0, 2.0):
        assert np.array(transferred.ComputeFlattened(time)) == pytest.approx(corners[:, :2] + time, abs=0.05)
    assert report.dropped == []


@pytest.mark.parametrize("size", [49, 0])
def test_element_size_that_cannot_be_meant_is_one(tmp_path, size):
    mesh = cloth()
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", NAMES.TexCoord2fArray, "vertex")
    primvar.Set(Vt.Vec2fArray.FromNumpy(np.array(mesh.GetPointsAttr().Get())[:, :2].copy()))
    primvar.GetAttr().SetMetadata("elementSize", size)
    after, report = simplified(tmp_path, mesh)
    transferred = UsdGeom.PrimvarsAPI(after).GetPrimvar("st")
    assert np.array(transferred.Get()) == pytest.approx(np.array(after.GetPointsAttr().Get())[:, :2], abs=0.05)
    assert transferred.GetElementSize() == 1
    assert report.problems == [f"{CLOTH}.primvars:st: elementSize {size} does not fit, taken as 1"]


def test_indices_of_another_type_are_noted_and_the_values_come_without_any(tmp_path):
    mesh = cloth()
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("tint", NAMES.Color3fArray, "faceVarying")
    primvar.Set([(1, 0, 0)])
    retype(mesh, "primvars:tint:indices", NAMES.UIntArray, [0] * 144)
    after, report = simplified(tmp_path, mesh)
    corners = len(after.GetFaceVertexIndicesAttr().Get())
    assert list(UsdGeom.PrimvarsAPI(after).GetPrimvar("tint").Get()) == [Gf.Vec3f(1, 0, 0)] * corners
    assert report.problems == [f"{CLOTH}.primvars:tint:indices: uint[], where USD reads int[]"]


def test_indices_that_are_no_whole_numbers_cost_their_primvar_alone(tmp_path):
    mesh = cloth()
    UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("tint", NAMES.Color3fArray, "faceVarying").Set([(1, 0, 0)])
    retype(mesh, "primvars:tint:indices", NAMES.FloatArray, [0.5] * 144)
    _, report = simplified(tmp_path, mesh)
    assert report.dropped == ["primvars:tint (faceVarying)"]


def test_points_that_no_face_uses_are_named(tmp_path):
    mesh = cloth()
    mesh.GetPointsAttr().Set([*mesh.GetPointsAttr().Get(), Gf.Vec3f(1), Gf.Vec3f(2)])
    assert simplified(tmp_path, mesh)[1].dropped == ["2 points that no face uses"]


def test_subdivision_that_nobody_authored_is_not_named(tmp_path):
    mesh = cloth()
    spec = mesh.GetPrim().GetStage().GetRootLayer().GetPrimAtPath(CLOTH)
    spec.RemoveProperty(spec.properties["subdivisionScheme"])
    assert simplified(tmp_path, mesh)[1].dropped == []


def test_quaternions_keep_their_length():
    rows = Rows(np.array([[0, 1], [1, 1]]), np.array([[0.5, 0.5], [1.0, 0.0]], dtype=np.float32))
    values = np.array([[0.0, 0, 0, 2], [0, 0, 0, -4]])
    assert rows.blend_directions(values, signed=False) == pytest.approx(np.array([[0, 0, 0, 3], [0, 0, 0, -4]]))


def test_empty_blend_shape_stays_empty():
    stage = Usd.Stage.CreateInMemory()
    shape = UsdSkel.BlendShape.Define(stage, "/Smile")
    shape.CreateOffsetsAttr([])
    shape.CreatePointIndicesAttr([3])
    rows = Rows(np.array([[0]]), np.ones((1, 1), dtype=np.float32))
    write_shape(stage, ShapeData(shape.GetPath(), {}), rows, 1.0)
    assert list(shape.GetPointIndicesAttr().Get()) == []
    assert list(shape.GetOffsetsAttr().Get()) == []
