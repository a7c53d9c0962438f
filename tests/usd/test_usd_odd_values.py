"""Values that a mesh is done with, and that are named."""

from __future__ import annotations

import json
import warnings

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom

from tests.support.cli import run
from tests.support.usd_stages import cloth_stage, skinned_stage
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.read.odd_values import find_odd_values
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.skeleton_poses import StagePoses

NAN = float("nan")
CLOTH, BODY = "/Root/Cloth", "/Char/Body"


def found(stage: Usd.Stage, path: str) -> list[str]:
    return find_odd_values(MeshSource(stage.GetPrimAtPath(path), StagePoses(stage)))


def mesh_of(stage: Usd.Stage) -> UsdGeom.Mesh:
    return UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH))


def uv(mesh: UsdGeom.Mesh, bad: float) -> None:
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, "vertex")
    values = [Gf.Vec2f(0, 0)] * 81
    primvar.Set(values, 1.0)
    primvar.Set([*values[:7], Gf.Vec2f(0, bad), *values[8:]], 2.0)


CLOTHS = {
    "UV": (lambda m: uv(m, float("inf")), ["/Root/Cloth.primvars:st: value 7 at time 2 is [0.0, inf] (1 such values)"]),
    "normals": (
        lambda m: m.CreateNormalsAttr([Gf.Vec3f(NAN)] * 81),
        ["/Root/Cloth.normals: value 0 at time default is [nan, nan, nan] (81 such values)"],
    ),
    "velocities": (
        lambda m: m.CreateVelocitiesAttr([Gf.Vec3f(0, 0, NAN)] * 81),
        ["/Root/Cloth.velocities: value 0 at time default is [0.0, 0.0, nan] (81 such values)"],
    ),
    "subset out of range": (
        lambda m: UsdGeom.Subset.CreateGeomSubset(m, "part", "face", [0, 64, -1]),
        ["/Root/Cloth/part.indices: face 64 at time default does not exist (64 faces; 2 such entries)"],
    ),
    "subset twice": (
        lambda m: UsdGeom.Subset.CreateGeomSubset(m, "part", "face", [3, 1, 3]),
        ["/Root/Cloth/part.indices: names a face twice at time default"],
    ),
    "points out of range": (
        lambda m: UsdGeom.Subset.CreateGeomSubset(m, "part", "point", [80, 81, -1]),
        ["/Root/Cloth/part.indices: point 81 at time default does not exist (81 points; 2 such entries)"],
    ),
    "points": (lambda m: UsdGeom.Subset.CreateGeomSubset(m, "part", "point", [80, 0]), []),
    "orientation": (
        lambda m: m.CreateOrientationAttr("up"),
        ["/Root/Cloth.orientation: 'up' at time default is none of rightHanded, leftHanded"],
    ),
    "visibility": (
        lambda m: m.CreateVisibilityAttr().Set("never", 3.0),
        ["/Root/Cloth.visibility: 'never' at time 3 is none of inherited, invisible"],
    ),
    "transform": (
        lambda m: m.AddTranslateOp().Set(Gf.Vec3d(NAN, 0, 0)),
        ["/Root/Cloth: its transform to the world at time 1 is not finite"],
    ),
    "flat transform": (
        lambda m: m.AddScaleOp().Set(Gf.Vec3f(1, 0, 1)),
        ["/Root/Cloth: its transform to the world at time 1 flattens it"],
    ),
    "nothing": (lambda m: uv(m, 0.5), []),
}


@pytest.mark.parametrize("kind", CLOTHS)
def test_value_of_a_mesh_is_named(kind):
    change, expected = CLOTHS[kind]
    stage = cloth_stage()
    change(mesh_of(stage))
    assert found(stage, CLOTH) == expected


WEIGHTS = "primvars:skel:jointWeights"
RIG = "/Char/Rig"


def weights(stage: Usd.Stage, factor: float, shift: float = 0.0) -> None:
    attribute = stage.GetPrimAtPath(BODY).GetAttribute(WEIGHTS)
    values = np.array(attribute.Get()).reshape(-1, 2)
    values[5] = values[5] * factor + np.float32([shift, -shift])
    attribute.Set(values.ravel().tolist())


SKINS = {
    "weights that sum to two": (lambda s: weights(s, 2.0), "jointWeights: the weights of point 5 at time default"),
    "negative weights": (lambda s: weights(s, 1.0, 1.0), "jointWeights: the weights of point 5 at time default"),
    "too few rotations": (
        lambda s: s.GetPrimAtPath(f"{RIG}/Anim").GetAttribute("rotations").Set([Gf.Quatf(1)], 2.0),
        "/Char/Rig/Anim.rotations: 1 values at time 2 for 2 joints",
    ),
    "too few matrices": (
        lambda s: s.GetPrimAtPath(f"{RIG}/Skel").GetAttribute("bindTransforms").Set([Gf.Matrix4d(1)]),
        "/Char/Rig/Skel.bindTransforms: 1 matrices for 2 joints",
    ),
    "joint twice": (
        lambda s: s.GetPrimAtPath(f"{RIG}/Skel").GetAttribute("joints").Set(["hip", "hip"]),
        "/Char/Rig/Skel.joints: names a joint twice",
    ),
}


@pytest.mark.parametrize("kind", SKINS)
def test_value_of_a_skin_is_named(kind):
    change, expected = SKINS[kind]
    stage = skinned_stage()
    change(stage)
    [text] = found(stage, BODY)
    assert expected in text


def test_sound_skin_has_none():
    assert found(skinned_stage(), BODY) == []


def test_command_line_warns_and_reports(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    mesh_of(stage).CreateNormalsAttr([Gf.Vec3f(NAN)] * 81)
    stage.Save()
    report = tmp_path / "report.json"
    files = (tmp_path / "in.usda", "-o", tmp_path / "out.usda", "--json", report)
    result = run("simplify", *files, "--ratio", 0.5, "--device", "cpu")
    assert result.exit_code == 0
    assert "warning: /Root/Cloth.normals: value 0 at time default is [nan, nan, nan]" in result.stderr
    [prim] = json.loads(report.read_text())["prims"]
    assert len(prim["problems"]) == 1


INFINITE = float("inf")


@pytest.mark.parametrize(
    ("kind", "bad"),
    [
        ("color vertex", [INFINITE]),
        ("color vertex", [INFINITE, -INFINITE]),
        ("color vertex", [NAN]),
        ("color vertex", [3e38, -3e38]),
        ("color faceVarying", [INFINITE, NAN]),
        ("opacity vertex", [INFINITE, -INFINITE]),
        ("normals vertex", [INFINITE, -INFINITE]),
        ("uv faceVarying", [INFINITE, -INFINITE]),
    ],
)
def test_values_that_are_not_finite_are_named_and_computed_with_no_warning_of_numpy(kind, bad, tmp_path):
    what, interpolation = kind.split()
    stage = cloth_stage(tmp_path / "in.usda")
    mesh = mesh_of(stage)
    name, value_type, width = {
        "color": ("displayColor", Sdf.ValueTypeNames.Color3fArray, 3),
        "opacity": ("displayOpacity", Sdf.ValueTypeNames.FloatArray, 1),
        "normals": ("normals", Sdf.ValueTypeNames.Normal3fArray, 3),
        "uv": ("map", Sdf.ValueTypeNames.TexCoord2fArray, 2),
    }[what]
    count = {"vertex": 81, "faceVarying": len(mesh.GetFaceVertexIndicesAttr().Get())}[interpolation]
    values = np.random.default_rng(2).random((count, width)).astype(np.float32)
    # Neighbours, so that vertices stand for several of them.
    values[: 12 * len(bad)] = np.repeat(np.array(bad, dtype=np.float32), 12)[:, None]
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(name, value_type, interpolation)
    primvar.Set(value_type.defaultValue.FromNumpy(values if width > 1 else values[:, 0].copy()))
    stage.Save()
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        report = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(ratio=0.4, device="cpu"))
    [prim] = report.prims
    assert (prim.status, prim.message) == ("simplified", None)
    named = [
        text for text in prim.problems if text.startswith(f"/Root/Cloth.primvars:{name}: value 0 at time default is ")
    ]
    assert len(named) == (not np.isfinite(bad).all())
    out = Usd.Stage.Open(str(tmp_path / "out.usda"))
    new = np.array(out.GetAttributeAtPath(f"/Root/Cloth.primvars:{name}").Get())
    # Where the input has numbers, the output has, too.
    assert np.isfinite(new).any()
    if np.isfinite(bad).all():
        assert np.isfinite(new).all()
