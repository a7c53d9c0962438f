"""A slice of the fuzz cases, and what they have found; `python -m tests.long.fuzz` runs more of them."""

from __future__ import annotations

import re
import subprocess
import sys

import numpy as np
import pytest
from pxr import Sdf, Tf, Usd, UsdGeom, Vt

import warpqem
from tests.support import fuzz_cases, meshes
from tests.support.usd_stages import cloth_stage, skinned_stage
from warpqem.errors import DegenerateMeshError, StageError
from warpqem.usd import SimplifyOptions, inspect_stage, simplify_stage
from warpqem.usd.checks.usd_errors import first_line, usd_errors_named

HALF = SimplifyOptions(ratio=0.5, device="cpu")


@pytest.fixture(scope="module", autouse=True)
def _stages():
    yield
    fuzz_cases.remove_stages()


@pytest.mark.parametrize("start", range(0, 200, 50))
def test_arrays_end_in_a_sound_result_or_a_named_error(start):
    ends = [fuzz_cases.array_case(seed) for seed in range(start, start + 50)]
    assert 0 < ends.count("done") < 50


def test_values_on_a_stage_end_in_a_sound_result_or_a_named_error():
    ends = [fuzz_cases.value_case(seed) for seed in range(30)]
    assert 0 < ends.count("done") < 30


def test_bytes_end_in_a_sound_result_or_a_named_error():
    # In a process of its own: USD may end it.
    code = (
        f"import sys; sys.path[:] = {sys.path!r}; from tests.support import fuzz_cases; "
        "print([fuzz_cases.byte_case(seed) for seed in range(25)]); fuzz_cases.remove_stages()"
    )
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert process.returncode == 0, process.stderr[-2000:]
    assert "StageError" in process.stdout


@pytest.mark.parametrize("size", [2e38, 3e38, 1e-40, 1e-42])
def test_size_whose_scale_is_beyond_single_precision_is_refused(size):
    points, faces = meshes.icosphere(1)
    with pytest.raises(DegenerateMeshError, match="bounding-box diagonal"):
        warpqem.simplify(points.astype(np.float64) * 2 * size, faces, ratio=0.5, device="cpu")


@pytest.mark.parametrize("size", [2.0**120, 2.0**-110])
def test_size_just_within_single_precision_is_done(size):
    points, faces = meshes.icosphere(1)
    whole = warpqem.simplify(points, faces, ratio=0.5, device="cpu")
    result = warpqem.simplify(points.astype(np.float64) * size, faces, ratio=0.5, device="cpu")
    assert np.array_equal(result.faces, whole.faces)
    assert np.allclose(result.points / np.float32(size), whole.points, atol=1e-6)


def test_refit_leaves_a_surface_without_area_as_it_is():
    points, faces = meshes.grid(5, 5)
    line = points * np.float32([1, 0, 0])
    with_refit, without = (
        warpqem.simplify(line, faces, ratio=0.5, refit=refit, device="cpu") for refit in (True, False)
    )
    assert np.array_equal(with_refit.points, without.points)


@pytest.mark.parametrize("name", ["jointIndices", "jointWeights"])
def test_half_a_skin_is_dropped(tmp_path, name):
    stage = skinned_stage(tmp_path / "in.usda")
    stage.GetPrimAtPath("/Char/Body").GetAttribute(f"primvars:skel:{name}").Clear()
    stage.Save()
    [prim] = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", HALF).prims
    other = {"jointIndices": "jointWeights", "jointWeights": "jointIndices"}[name]
    assert prim.status == "simplified"
    assert f"primvars:skel:{other} without skel:{name}" in prim.dropped
    out = Usd.Stage.Open(str(tmp_path / "out.usda"))
    assert out.GetPrimAtPath("/Char/Body").GetAttribute(f"primvars:skel:{other}").Get() is None


def test_what_usd_raises_is_named_also_where_its_message_is_no_text():
    class Unreadable(Tf.ErrorException):
        def __str__(self):
            return b"\xff".decode()

    with pytest.raises(StageError, match=r"/A: USD fails on a value of it .*Unreadable with"), usd_errors_named("/A"):
        raise Unreadable
    assert first_line(Unreadable()).endswith("no text")


def test_damaged_metadata_is_named(tmp_path, monkeypatch):
    stage = cloth_stage(tmp_path / "in.usda")
    stage.GetRootLayer().pseudoRoot.SetInfo("customLayerData", {"a": 1})
    stage.Save()
    monkeypatch.setattr("warpqem.usd.read.stage_views.anchored", lambda value, layer: 3)
    monkeypatch.setattr("warpqem.usd.read.stage_views.Sdf.AssetPath", dict)
    with pytest.raises(StageError, match=r"in\.usda: the metadata 'customLayerData' is damaged") as raised:
        simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", HALF)
    # Not even while the error is at hand.
    assert raised.value is not None
    assert [path.name for path in tmp_path.iterdir()] == ["in.usda"]


@pytest.mark.parametrize("suffix", [".usda", ".usd", ".usdc"])
def test_nan_with_a_sign_does_not_make_the_output_unreadable(tmp_path, flatten, suffix):
    stage = cloth_stage(tmp_path / "in.usdc")
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth"))
    for name, kind, count in (("heat", "vertex", 81), ("cold", "constant", 1)):
        primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(name, Sdf.ValueTypeNames.HalfArray, kind)
        primvar.Set(Vt.HalfArray.FromNumpy(np.copysign(np.full(count, np.nan, dtype=np.float16), np.float16(-1))))
    note = stage.GetPrimAtPath("/Root").CreateAttribute("note", Sdf.ValueTypeNames.String)
    note.Set("a -nan, and\n-nan")
    stage.Save()
    options = SimplifyOptions(ratio=0.5, device="cpu", flatten=flatten)
    simplify_stage(tmp_path / "in.usdc", tmp_path / f"out{suffix}", options)
    out = Usd.Stage.Open(str(tmp_path / f"out{suffix}"))
    values = np.array(UsdGeom.PrimvarsAPI(out.GetPrimAtPath("/Root/Cloth")).GetPrimvar("heat").Get())
    assert len(values)
    assert np.isnan(values).all()
    assert out.GetPrimAtPath("/Root").GetAttribute("note").Get() == "a -nan, and\n-nan"


@pytest.mark.parametrize("name", ["int[] faceVertexIndices", "int[] faceVertexCounts"])
def test_attribute_of_a_type_that_does_not_exist_is_named(tmp_path, name):
    cloth_stage(tmp_path / "in.usda")
    text = (tmp_path / "in.usda").read_text()
    kind, _, rest = name.partition(" ")
    (tmp_path / "in.usda").write_text(text.replace(name, f"x{kind} {rest}"))
    report = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", HALF)
    assert report.prims[0].status == "failed"
    assert report.prims[0].message.startswith("/Root/Cloth")


def test_primvar_that_is_only_called_like_one_of_a_skin_is_transferred(tmp_path):
    stage = skinned_stage(tmp_path / "in.usda")
    primvars = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/Char/Body"))
    primvars.CreatePrimvar("skel:mine", Sdf.ValueTypeNames.FloatArray, "vertex").Set([1.0] * 81)
    stage.Save()
    simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", HALF)
    out = Usd.Stage.Open(str(tmp_path / "out.usda"))
    mesh = UsdGeom.Mesh(out.GetPrimAtPath("/Char/Body"))
    values = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("skel:mine").Get()
    assert list(values) == [1.0] * len(mesh.GetPointsAttr().Get())


def test_refit_does_not_send_vertices_far_off_where_few_faces_are_left():
    points, faces = meshes.book(3, 3)
    faces = faces[:30]
    result = warpqem.simplify(points, faces, target_faces=2, metric="qem", refit=True, device="cpu")
    reach = np.linalg.norm(np.ptp(points, axis=0))
    assert np.abs(result.points).max() < np.abs(points).max() + reach


@pytest.mark.parametrize("missing", ["/Root", "/Root/Cloth", "/Root/Cloth.points"])
def test_what_a_damaged_file_lists_but_does_not_hold_is_named(tmp_path, monkeypatch, missing):
    cloth_stage(tmp_path / "in.usda")

    class Damaged:
        """A layer as USD opens it from crate files with a wrong table of specs."""

        def __init__(self, layer):
            self.layer = layer

        def GetObjectAtPath(self, path):  # noqa: N802, the name is USD's
            return None if path == Sdf.Path(missing) else self.layer.GetObjectAtPath(path)

        def __getattr__(self, name):
            return getattr(self.layer, name)

    opened = Sdf.Layer.FindOrOpen(str(tmp_path / "in.usda"))
    monkeypatch.setattr("warpqem.usd.checks.input_check.Sdf.Layer.FindOrOpen", lambda place: Damaged(opened))
    with pytest.raises(StageError, match=rf"in\.usda: damaged: {missing} is listed, but is not there"):
        simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", HALF)


def test_sample_at_a_time_that_is_no_number_is_named(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    text = (tmp_path / "in.usda").read_text()
    assert "1: [" in text
    (tmp_path / "in.usda").write_text(text.replace("1: [", "nan: [", 1))
    with pytest.raises(StageError, match=r"/Root/Cloth\.points has a sample at time nan"):
        simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", HALF)


def test_points_that_are_no_points_are_named(tmp_path):
    cloth_stage(tmp_path / "in.usda", size=2)
    text = (tmp_path / "in.usda").read_text()
    numbers = "[" + ", ".join("0" * 9) + "]"
    text = re.sub(r"point3f\[\] points\.timeSamples = \{[^}]*\}", f"float[] points = {numbers}", text)
    (tmp_path / "in.usda").write_text(text)
    [prim] = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", HALF).prims
    assert prim.status == "failed"
    assert "/Root/Cloth.points: declared as float[] in " in prim.message


@pytest.mark.parametrize("sampled", [False, True])
def test_empty_asset_paths_keep_their_place(tmp_path, sampled, flatten):
    stage = cloth_stage(tmp_path / "in.usda")
    primvars = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/Root/Cloth"))
    primvar = primvars.CreatePrimvar("maps", Sdf.ValueTypeNames.AssetArray, "uniform")
    paths = [Sdf.AssetPath("" if face % 2 else "./a.png") for face in range(64)]
    (tmp_path / "a.png").write_bytes(b"picture")
    primvar.Set(paths, *((1.0,) if sampled else ()))
    stage.Save()
    simplify_stage(
        tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(ratio=0.5, device="cpu", flatten=flatten)
    )
    out = Usd.Stage.Open(str(tmp_path / "out.usda"))
    mesh = UsdGeom.Mesh(out.GetPrimAtPath("/Root/Cloth"))
    values = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("maps").Get(1.0)
    assert len(values) == len(mesh.GetFaceVertexCountsAttr().Get())
    assert {value.path for value in values} == {"", "./a.png"}


@pytest.mark.parametrize("name", ["jointIndices", "jointWeights"])
def test_skin_of_which_one_half_is_constant_is_dropped(tmp_path, name):
    stage = skinned_stage(tmp_path / "in.usda")
    UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/Char/Body")).GetPrimvar(f"skel:{name}").SetInterpolation("constant")
    stage.Save()
    [prim] = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", HALF).prims
    assert prim.status == "simplified"
    out = Usd.Stage.Open(str(tmp_path / "out.usda"))
    body = out.GetPrimAtPath("/Char/Body")
    for half in ("jointIndices", "jointWeights"):
        assert body.GetAttribute(f"primvars:skel:{half}").Get() is None


def test_element_size_of_zero_is_a_problem_that_inspection_names(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    primvar = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/Root/Cloth")).CreatePrimvar(
        "a", Sdf.ValueTypeNames.FloatArray, "vertex"
    )
    primvar.Set([1.0])
    primvar.GetAttr().SetMetadata("elementSize", 0)
    stage.Save()
    [info] = inspect_stage(tmp_path / "in.usda")
    assert "primvars:a: elementSize 0" in info.problems
