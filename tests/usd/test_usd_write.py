"""Writing simplified meshes over an input."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, UsdSkel

import warpqem
from tests.support.usd_stages import FRAMES, cloth_stage, skinned_stage
from warpqem.errors import OptionError, StageError
from warpqem.usd import SimplifyOptions
from warpqem.usd.commands.mesh_job import MeshJob
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.skeleton_poses import StagePoses
from warpqem.usd.read.stage_views import copy_stage_metadata
from warpqem.usd.write.attribute_transfer import AttributeTransfer
from warpqem.usd.write.layer_files import check_output_path
from warpqem.usd.write.write import OverLayer

CLOTH = "/Root/Cloth"
BODY = "/Char/Body"


@dataclass
class Replacement:
    """A simplified mesh, ready to be written."""

    times: list[float] | None
    points: np.ndarray
    faces: np.ndarray
    transfer: AttributeTransfer

    def write(self, layer: OverLayer, path: str) -> list[str]:
        samples = layer.point_samples(path, self.times)
        samples.begin(*self.points.shape[:2], self.faces)
        samples.write(slice(0, len(self.points)), self.points)
        return layer.replace_mesh(path, samples, self.times, self.faces, self.transfer)


def simplified(source: Usd.Stage, path: str = CLOTH) -> Replacement:
    """A mesh simplified to 40 faces, baked where it has a skin."""
    mesh_source = MeshSource(source.GetPrimAtPath(path), StagePoses(source))
    job = MeshJob.prepare(mesh_source, SimplifyOptions(ratio=1.0, bake=True))
    result = warpqem.simplify(job.frames, job.faces, target_faces=40, seams=job.seams.hold(), device="cpu")
    return Replacement(job.written_times, result.points, result.faces, job.transfer(result, "cpu"))


def dressed_cloth(path: Path) -> Usd.Stage:
    """A cloth with arrays that do not fit its topology, so that nothing can be carried, and some without one."""
    stage = cloth_stage(path)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH))
    primvars = UsdGeom.PrimvarsAPI(mesh)
    st = primvars.CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, "faceVarying")
    st.Set([Gf.Vec2f(0)] * 3)
    st.SetIndices([0] * 255)
    primvars.CreatePrimvar("wet", Sdf.ValueTypeNames.FloatArray, "vertex").Set([0.5] * 80)
    primvars.CreatePrimvar("id", Sdf.ValueTypeNames.IntArray, "uniform").Set([1] * 63)
    primvars.CreatePrimvar("tint", Sdf.ValueTypeNames.Color3fArray, "constant").Set([Gf.Vec3f(1)])
    mesh.CreateNormalsAttr([Gf.Vec3f(0, 0, 1)] * 80)
    mesh.CreateVelocitiesAttr().Set([Gf.Vec3f(0)] * 81, 1.0)
    mesh.CreateCreaseIndicesAttr([0, 1])
    mesh.CreateCreaseLengthsAttr([2])
    mesh.CreateCreaseSharpnessesAttr([1.0])
    mesh.CreatePurposeAttr("render")
    UsdGeom.Subset.CreateGeomSubset(mesh, "pins", "point", [0, 1], "pins", "unrestricted")
    material = UsdShade.Material.Define(stage, "/Root/Paint")
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    stage.GetRootLayer().Save()
    return stage


def written(tmp_path: Path, source: Usd.Stage, flatten: bool, path: str = CLOTH) -> Usd.Stage:
    layer = OverLayer(source)
    simplified(source, path).write(layer, path)
    output = tmp_path / "out.usda"
    layer.save(output, flatten)
    return Usd.Stage.Open(str(output))


def test_points_and_faces_are_the_new_ones(tmp_path, flatten):
    source = dressed_cloth(tmp_path / "in.usda")
    expected = simplified(source)
    stage = written(tmp_path, source, flatten)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH))
    assert mesh.GetPointsAttr().GetTimeSamples() == FRAMES
    for pose, time in zip(expected.points, FRAMES, strict=True):
        np.testing.assert_array_equal(mesh.GetPointsAttr().Get(time), pose)
    assert list(mesh.GetFaceVertexCountsAttr().Get()) == [3] * len(expected.faces)
    assert list(mesh.GetFaceVertexIndicesAttr().Get()) == expected.faces.ravel().tolist()
    assert mesh.GetSubdivisionSchemeAttr().Get() == "none"


def test_still_mesh_gets_a_default_value_only(tmp_path, flatten):
    source = cloth_stage(tmp_path / "in.usda", times=None)
    stage = written(tmp_path, source, flatten)
    points = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)).GetPointsAttr()
    assert points.GetNumTimeSamples() == 0
    np.testing.assert_array_equal(points.Get(), simplified(source).points[0])


def test_animated_mesh_gets_no_default_value(tmp_path, flatten):
    stage = written(tmp_path, dressed_cloth(tmp_path / "in.usda"), flatten)
    assert UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)).GetPointsAttr().Get() is None


def test_stale_default_of_the_input_is_replaced(tmp_path, flatten):
    source = dressed_cloth(tmp_path / "in.usda")
    UsdGeom.Mesh(source.GetPrimAtPath(CLOTH)).GetPointsAttr().Set([Gf.Vec3f(0)] * 81)
    source.GetRootLayer().Save()
    stage = written(tmp_path, source, flatten)
    assert len(UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)).GetPointsAttr().Get()) < 81


def test_extent_is_that_of_each_frame(tmp_path, flatten):
    source = dressed_cloth(tmp_path / "in.usda")
    pose = simplified(source).points[1]
    stage = written(tmp_path, source, flatten)
    extent = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)).GetExtentAttr()
    assert extent.GetTimeSamples() == FRAMES
    np.testing.assert_array_equal(extent.Get(2.0), [pose.min(axis=0), pose.max(axis=0)])


def test_what_refers_to_the_old_topology_is_gone(tmp_path, flatten):
    stage = written(tmp_path, dressed_cloth(tmp_path / "in.usda"), flatten)
    prim = stage.GetPrimAtPath(CLOTH)
    for name in ("st", "wet", "id"):
        assert not prim.GetAttribute(f"primvars:{name}").HasAuthoredValue()
    assert not prim.GetAttribute("primvars:st:indices").HasAuthoredValue()
    for name in ("normals", "velocities", "creaseIndices", "creaseLengths", "creaseSharpnesses"):
        assert not prim.GetAttribute(name).HasAuthoredValue()
    assert UsdGeom.Subset.GetAllGeomSubsets(UsdGeom.Mesh(prim)) == []


def test_what_does_not_refer_to_it_stays(tmp_path, flatten):
    stage = written(tmp_path, dressed_cloth(tmp_path / "in.usda"), flatten)
    prim = stage.GetPrimAtPath(CLOTH)
    assert list(UsdGeom.PrimvarsAPI(prim).GetPrimvar("tint").Get()) == [Gf.Vec3f(1)]
    assert UsdGeom.Imageable(prim).GetPurposeAttr().Get() == "render"
    assert UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0].GetPath() == "/Root/Paint"


def test_everything_dropped_is_named(tmp_path):
    source = dressed_cloth(tmp_path / "in.usda")
    UsdGeom.Mesh(source.GetPrimAtPath(CLOTH)).GetSubdivisionSchemeAttr().Set("loop")
    dropped = simplified(source).write(OverLayer(source), CLOTH)
    assert sorted(dropped) == [
        "1 GeomSubset of points or edges",
        "creaseIndices",
        "creaseLengths",
        "creaseSharpnesses",
        "normals (vertex)",
        "primvars:id (uniform)",
        "primvars:st (faceVarying)",
        "primvars:wet (vertex)",
        "subdivision (loop)",
        "velocities",
    ]


def test_flat_file_keeps_no_trace_of_what_was_dropped(tmp_path):
    written(tmp_path, dressed_cloth(tmp_path / "in.usda"), True)
    layer = Sdf.Layer.FindOrOpen(str(tmp_path / "out.usda"))
    spec = layer.GetPrimAtPath(CLOTH)
    assert "primvars:st" not in spec.properties
    assert "normals" not in spec.properties
    assert not spec.nameChildren


def test_stage_metadata_is_that_of_the_input(tmp_path, flatten):
    stage = written(tmp_path, dressed_cloth(tmp_path / "in.usda"), flatten)
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 0.01
    assert (stage.GetTimeCodesPerSecond(), stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (30, 1, 4)
    assert stage.GetDefaultPrim().GetPath() == "/Root"


def test_stage_metadata_is_written_in_an_order_that_does_not_hang_on_addresses(tmp_path):
    class Root:
        def __init__(self):
            self.keys = []

        def SetInfo(self, key, value):  # noqa: N802, as USD names it
            self.keys.append(key)

    class Layer:
        pseudoRoot = Root()  # noqa: N815

    stage = cloth_stage(tmp_path / "in.usda")
    copy_stage_metadata(stage.GetRootLayer(), Layer)
    assert len(Layer.pseudoRoot.keys) > 4
    assert Layer.pseudoRoot.keys == sorted(Layer.pseudoRoot.keys)


def test_layer_names_the_input_by_a_relative_path(tmp_path):
    (tmp_path / "deep").mkdir()
    layer = OverLayer(cloth_stage(tmp_path / "in.usda"))
    layer.save(tmp_path / "deep" / "out.usda")
    assert list(Sdf.Layer.FindOrOpen(str(tmp_path / "deep" / "out.usda")).subLayerPaths) == ["../in.usda"]


def test_flat_file_needs_no_other_file(tmp_path):
    written(tmp_path, dressed_cloth(tmp_path / "in.usda"), True)
    assert not Sdf.Layer.FindOrOpen(str(tmp_path / "out.usda")).GetExternalReferences()


def test_flat_file_names_assets_by_relative_paths(tmp_path):
    source = dressed_cloth(tmp_path / "in.usda")
    (tmp_path / "paint.png").write_bytes(b"")
    shader = UsdShade.Shader.Define(source, "/Root/Paint/Texture")
    shader.CreateInput("file", Sdf.ValueTypeNames.Asset).Set("./paint.png")
    source.GetRootLayer().Save()
    stage = written(tmp_path, source, True)
    assert stage.GetAttributeAtPath("/Root/Paint/Texture.inputs:file").Get().path == "./paint.png"


def test_skin_binding_is_gone(tmp_path, flatten):
    source = skinned_stage(tmp_path / "in.usda")
    layer = OverLayer(source)
    dropped = simplified(source, BODY).write(layer, BODY)
    layer.save(tmp_path / "out.usda", flatten)
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    assert "skin binding with 1 blend shape" in dropped
    assert not [
        p for p in stage.GetPrimAtPath("/Char/Body").GetAuthoredAttributes() if "skel" in p.GetName() and p.Get()
    ]
    assert_not_skinned(stage, "/Char/Body")


def test_flat_file_has_no_trace_of_a_skin(tmp_path):
    source = skinned_stage(tmp_path / "in.usda")
    layer = OverLayer(source)
    simplified(source, BODY).write(layer, BODY)
    layer.save(tmp_path / "out.usda", flatten=True)
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    body = stage.GetPrimAtPath("/Char/Body")
    assert not body.HasAPI(UsdSkel.BindingAPI)
    assert not [prop for prop in body.GetAuthoredProperties() if "skel" in prop.GetName()]
    assert not body.GetChildren()


def test_binding_inherited_from_an_ancestor_is_stopped(tmp_path, flatten):
    source = skinned_stage(tmp_path / "in.usda", rigid=True)
    body = UsdSkel.BindingAPI(source.GetPrimAtPath("/Char/Body"))
    group = UsdSkel.BindingAPI.Apply(source.GetPrimAtPath("/Char"))
    group.CreateSkeletonRel().SetTargets(body.GetSkeletonRel().GetTargets())
    group.CreateJointIndicesPrimvar(True, 1).Set([1])
    group.CreateJointWeightsPrimvar(True, 1).Set([1.0])
    for prop in source.GetPrimAtPath("/Char/Body").GetAuthoredProperties():
        if "skel:" in prop.GetName():
            source.GetPrimAtPath("/Char/Body").RemoveProperty(prop.GetName())
    source.GetRootLayer().Save()
    layer = OverLayer(source)
    simplified(source, BODY).write(layer, BODY)
    layer.save(tmp_path / "out.usda", flatten)
    assert_not_skinned(Usd.Stage.Open(str(tmp_path / "out.usda")), "/Char/Body")


def assert_not_skinned(stage: Usd.Stage, path: str) -> None:
    root = UsdSkel.Root(stage.GetPrimAtPath("/Char"))
    cache = UsdSkel.Cache()
    cache.Populate(root, Usd.PrimDefaultPredicate)
    for binding in cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate):
        for query in binding.GetSkinningTargets():
            assert query.GetPrim().GetPath() != path or not (query.HasJointInfluences() or query.HasBlendShapes())


def test_validators_of_usd_find_nothing_new(tmp_path, flatten):
    validation = pytest.importorskip("pxr.UsdValidation")
    context = validation.ValidationContext(validation.ValidationRegistry().GetOrLoadAllValidators())
    source = skinned_stage(tmp_path / "in.usda")
    layer = OverLayer(source)
    simplified(source, BODY).write(layer, BODY)
    layer.save(tmp_path / "out.usda", flatten)
    known = {error.GetName() for error in context.Validate(source)}
    found = context.Validate(Usd.Stage.Open(str(tmp_path / "out.usda")))
    assert [error.GetMessage() for error in found if error.GetName() not in known] == []


def test_point_that_is_not_finite_is_never_written(tmp_path):
    source = dressed_cloth(tmp_path / "in.usda")
    broken = simplified(source)
    broken.points[1, 3, 0] = np.inf
    with pytest.raises(StageError, match=r"/Root/Cloth\.points: the simplified point 3 at time 2"):
        broken.write(OverLayer(source), CLOTH)


def test_vertex_colors_hide_those_of_the_input(tmp_path):
    source = dressed_cloth(tmp_path / "in.usda")
    primvar = UsdGeom.Mesh(source.GetPrimAtPath(CLOTH)).CreateDisplayColorPrimvar("faceVarying")
    primvar.Set([Gf.Vec3f(1)])
    primvar.SetIndices([0] * 256)
    source.GetRootLayer().Save()
    layer = OverLayer(source)
    layer.set_vertex_colors(CLOTH, None, np.full((1, 81, 3), 0.25, dtype=np.float32))
    layer.save(tmp_path / "out.usda")
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    colors = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)).GetDisplayColorPrimvar()
    assert (colors.GetInterpolation(), colors.IsIndexed(), len(colors.Get())) == ("vertex", False, 81)


@pytest.mark.parametrize("name", ["in.usda", "link.usda", "./in.usda"])
def test_input_is_never_the_output(tmp_path, monkeypatch, name):
    cloth_stage(tmp_path / "in.usda")
    (tmp_path / "link.usda").symlink_to("in.usda")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(OptionError, match="never overwritten"):
        check_output_path(name, ["in.usda"])


@pytest.mark.parametrize("name", ["out.usdz", "out", "nowhere/out.usd", "folder.usd"])
def test_output_that_cannot_be_written_is_refused(tmp_path, name):
    (tmp_path / "folder.usd").mkdir()
    with pytest.raises(OptionError, match="output"):
        check_output_path(tmp_path / name, [])


def test_nothing_is_left_behind_when_writing_fails(tmp_path, monkeypatch):
    layer = OverLayer(dressed_cloth(tmp_path / "in.usda"))

    def refuse(source: str, target: str) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(StageError, match="disk full"):
        layer.save(tmp_path / "out.usda")
    assert [path.name for path in tmp_path.iterdir()] == ["in.usda"]
