"""Properties of outputs, over generated stages."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from pxr import Sdf, Usd, UsdGeom, UsdSkel, Vt

from tests.support.rich_stage import KINDS
from tests.support.usd_checks import check_stage, compare_properties
from tests.support.usd_stages import cloth_stage, define_skinned
from warpqem.usd import SimplifyOptions, simplify_stage

FAMILY_TYPES = ["partition", "nonOverlapping", "unrestricted"]


@st.composite
def primvars(draw) -> dict[str, object]:
    return {
        "kind": draw(st.sampled_from(sorted(KINDS))),
        "interpolation": draw(st.sampled_from(["constant", "uniform", "vertex", "varying", "faceVarying"])),
        "times": draw(st.lists(st.sampled_from([0.0, 1.0, 2.5, 4.0]), unique=True, max_size=2)),
        "element_size": draw(st.sampled_from([1, 1, 1, 2])),
        "indexed": draw(st.booleans()),
        "distinct": draw(st.sampled_from([1, 2, 1000])),
        # Now and then a length that does not fit.
        "extra": draw(st.sampled_from([0, 0, 0, 0, 1])),
    }


@st.composite
def stages(draw) -> dict[str, object]:
    return {
        "size": draw(st.integers(2, 5)),
        "times": draw(st.sampled_from([None, [1.0], [1.0, 2.0, 4.0]])),
        "triangles": draw(st.booleans()),
        "skin": draw(st.sampled_from([False, False, True])),
        "scheme": draw(st.sampled_from(["none", "catmullClark", "loop"])),
        "orientation": draw(st.sampled_from(["rightHanded", "leftHanded"])),
        "primvars": draw(st.lists(primvars(), max_size=4)),
        "family": draw(st.sampled_from([None, *FAMILY_TYPES])),
        "holes": draw(st.lists(st.integers(0, 3), unique=True, max_size=1)),
        "split": draw(st.booleans()),
        "ratio": draw(st.sampled_from([0.3, 0.6])),
        "bake": draw(st.booleans()),
    }


def build(path: Path, recipe: dict[str, object]) -> str:
    """Write a stage; returns the path of its mesh."""
    if recipe["skin"]:
        stage = Usd.Stage.CreateNew(str(path))
        mesh = define_skinned(stage)
    else:
        stage = cloth_stage(path, size=recipe["size"], times=recipe["times"], triangles=recipe["triangles"])
        mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth"))
        if recipe["split"]:
            _split_points(mesh)
    mesh.CreateSubdivisionSchemeAttr(recipe["scheme"])
    mesh.CreateOrientationAttr(recipe["orientation"])
    if recipe["holes"]:
        mesh.CreateHoleIndicesAttr(recipe["holes"])
    faces = len(mesh.GetFaceVertexCountsAttr().Get())
    corners = len(mesh.GetFaceVertexIndicesAttr().Get())
    points = len(mesh.GetPointsAttr().Get(Usd.TimeCode.EarliestTime()))
    lengths = {"constant": 1, "uniform": faces, "vertex": points, "varying": points, "faceVarying": corners}
    for index, item in enumerate(recipe["primvars"]):
        _add_primvar(mesh, f"p{index}", item, lengths[item["interpolation"]])
    if recipe["family"]:
        halves = [range(faces // 2), range(faces // 2, faces)]
        if recipe["family"] == "unrestricted":
            halves[1] = range(faces // 3, faces)
        for index, half in enumerate(halves):
            UsdGeom.Subset.CreateGeomSubset(mesh, f"part{index}", "face", list(half), "parts", recipe["family"])
    stage.Save()
    return str(mesh.GetPath())


def _split_points(mesh: UsdGeom.Mesh) -> None:
    """Give every face points of its own."""
    indices = np.array(mesh.GetFaceVertexIndicesAttr().Get())
    attribute = mesh.GetPointsAttr()
    for code in map(Usd.TimeCode, attribute.GetTimeSamples() or [Usd.TimeCode.Default()]):
        attribute.Set(Vt.Vec3fArray.FromNumpy(np.array(attribute.Get(code))[indices]), code)
    mesh.GetFaceVertexIndicesAttr().Set(list(range(len(indices))))


def _add_primvar(mesh: UsdGeom.Mesh, name: str, item: dict[str, object], length: int) -> None:
    type_name, value = KINDS[item["kind"]]
    size = item["element_size"]
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(name, type_name, item["interpolation"], size)
    distinct = min(item["distinct"], length)
    entries = distinct if item["indexed"] else length
    values = [value(i % distinct) for i in range(size * entries + item["extra"])]
    for code in map(Usd.TimeCode, item["times"] or [Usd.TimeCode.Default()]):
        primvar.Set(values, code)
    if item["indexed"]:
        primvar.SetIndices(Vt.IntArray([i % distinct for i in range(length)]))


@settings(max_examples=25, deadline=None)
@given(stages())
def test_outputs_fit_agree_and_lose_nothing_unsaid(recipe):
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "tex0.txt").touch()
        (folder / "tex1.txt").touch()
        path = build(folder / "in.usda", recipe)
        before = Usd.Stage.Open(str(folder / "in.usda"))
        results = {}
        for form in (False, True):
            options = SimplifyOptions(ratio=recipe["ratio"], device="cpu", flatten=form, bake=recipe["bake"])
            report = simplify_stage(folder / "in.usda", folder / f"out{form}.usda", options)
            [prim] = report.prims
            assert prim.status in ("simplified", "kept"), prim.message
            after = Usd.Stage.Open(str(folder / f"out{form}.usda"))
            if prim.status == "simplified":
                check_stage(after, before if not recipe["skin"] else None)
                _check_family(UsdGeom.Mesh(after.GetPrimAtPath(path)), recipe["family"])
            _check_losses(before, after, prim.dropped, recipe["bake"])
            results[form] = after
        _check_equal(*results.values(), path)


def _check_family(mesh: UsdGeom.Mesh, family_type: str | None) -> None:
    if family_type:
        valid, reason = UsdGeom.Subset.ValidateFamily(mesh, "face", "parts")
        assert valid, reason


def _check_losses(before: Usd.Stage, after: Usd.Stage, lines: list[str], bake: bool) -> None:
    """What is gone has a line; indices go with the values that are written out without them, and skins as one."""
    for lost, verdict in compare_properties(before, after).items():
        name = lost.rsplit(".", 1)[-1]
        if verdict != "gone" or name.endswith(":indices") or (bake and ("skel" in name or "/" in name)):
            # A skin and blend shapes that are baked are no loss: that was asked for.
            continue
        words = ["skin"] if "skel" in name or "/" in name else [name]
        assert any(word in line for word in words for line in lines), (lost, lines)


def _check_equal(layered: Usd.Stage, flat: Usd.Stage, path: str) -> None:
    meshes = [UsdGeom.Mesh(stage.GetPrimAtPath(path)) for stage in (layered, flat)]
    assert meshes[0].GetPointsAttr().GetTimeSamples() == meshes[1].GetPointsAttr().GetTimeSamples()
    for time in (Usd.TimeCode.Default(), 0.0, 1.0, 1.5, 2.0, 3.0, 4.0, 9.0):
        assert meshes[0].GetPointsAttr().Get(time) == meshes[1].GetPointsAttr().Get(time)
        posed = [_posed(stage, path, time) for stage in (layered, flat)]
        if posed[0] is not None:
            np.testing.assert_array_equal(*posed)


def _posed(stage: Usd.Stage, path: str, time: float | Usd.TimeCode) -> np.ndarray | None:
    root = stage.GetPrimAtPath(Sdf.Path(path).GetPrefixes()[0])
    cache = UsdSkel.Cache()
    if not root.IsA(UsdSkel.Root) or not cache.Populate(UsdSkel.Root(root), Usd.PrimDefaultPredicate):
        return None
    points = Vt.Vec3fArray(UsdGeom.Mesh(stage.GetPrimAtPath(path)).GetPointsAttr().Get(time) or [])
    for binding in cache.ComputeSkelBindings(UsdSkel.Root(root), Usd.PrimDefaultPredicate):
        skeleton = cache.GetSkelQuery(binding.GetSkeleton())
        for query in binding.GetSkinningTargets():
            if query.HasJointInfluences() and len(points):
                assert query.ComputeSkinnedPoints(skeleton.ComputeSkinningTransforms(time), points, time)
                return np.array(points)
    return None
