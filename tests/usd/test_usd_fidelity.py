"""Every property of every prim of an output against what is to become of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from tests.support.rich_stage import CLOTH, KINDS, LENGTHS, rich_stage
from tests.support.usd_checks import check_stage, compare_properties, metadata, plain, values_of
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.write.stage_report import StageReport

TRANSFERRED = [*KINDS, "sized", "moving", "indexed", "turning"]

# What becomes of the properties of the mesh. All that is not named here is kept, value by value, with its metadata.
RECOMPUTED = ["points", "faceVertexCounts", "faceVertexIndices", "extent", "subdivisionScheme"]
REMAPPED = [
    *(f"primvars:{name}_{kind}" for name in TRANSFERRED for kind in LENGTHS if kind != "constant"),
    *("primvars:st", "primvars:gaps", "primvars:normals", "primvars:blockedOnce"),
    *("normals", "velocities", "accelerations"),
]  # fmt: skip
# Values at points and faces come without indices, those at corners with new ones.
INDICES = {
    **{f"primvars:{name}_{kind}:indices": "gone" for name in ("indexed", "turning")
       for kind in ("uniform", "vertex", "varying")},
    **{f"primvars:{name}_faceVarying:indices": "added" for name in (*KINDS, "sized", "moving")},
    **dict.fromkeys(["primvars:indexed_faceVarying:indices", "primvars:turning_faceVarying:indices"], "changed"),
    **dict.fromkeys(["primvars:gaps:indices", "primvars:normals:indices"], "changed"),
    "primvars:st:indices": "added",
}  # fmt: skip
# Equal values are one entry of those indices, so that as few as there were stay as they were.
STILL_THE_SAME = ["primvars:indexed_faceVarying", "primvars:normals"]
SUBSETS = ["materialBind0", "materialBind1", "rooms0", "rooms1", "loose0", "loose1", "loose2", "moving"]
# What is taken off the mesh, and the line of the report that says so.
DROPPED = {
    ".primvars:short": "primvars:short (vertex)",
    ".holeIndices": "holeIndices (the holes stay, without faces)",
    ".creaseIndices": "creaseIndices",
    ".creaseLengths": "creaseLengths",
    ".creaseSharpnesses": "creaseSharpnesses",
    ".cornerIndices": "cornerIndices",
    ".cornerSharpnesses": "cornerSharpnesses",
    "/pins": "2 GeomSubsets of points or edges",
    "/rims": "2 GeomSubsets of points or edges",
}
# Other lines: what stays, but not as it was.
LINES = {
    "unauthoredValuesIndex of primvars:gaps",
    "the order of studio:points (an entry for each old point; make it a primvar)",
    "the order of studio:faces (an entry for each old face; make it a primvar)",
    "the order of studio:corners (an entry for each old corner; make it a primvar)",
    "subdivision (catmullClark)",
    # One face of 64, which is overlapped by others.
    "all faces of GeomSubset loose2",
}


def convert(folder: Path, **options: object) -> tuple[Usd.Stage, Usd.Stage, StageReport]:
    (folder / "out").mkdir()
    given = SimplifyOptions(**{"ratio": 0.4, "device": "cpu", **options})
    report = simplify_stage(folder / "in.usda", folder / "out" / "out.usda", given)
    assert report.failed == []
    return Usd.Stage.Open(str(folder / "in.usda")), Usd.Stage.Open(str(folder / "out" / "out.usda")), report


@pytest.fixture(scope="module", params=[False, True], ids=["layer", "flat"])
def rich(request, tmp_path_factory):
    """The rich stage before and after simplification, and the report."""
    folder = tmp_path_factory.mktemp("rich")
    rich_stage(folder / "in.usda")
    return convert(folder, flatten=request.param)


def test_every_property_becomes_what_the_table_says(rich):
    before, after, _report = rich
    expected = {
        **{f"{CLOTH}.{name}": "changed" for name in (*RECOMPUTED, *REMAPPED) if name not in STILL_THE_SAME},
        **{f"{CLOTH}.{name}": verdict for name, verdict in INDICES.items()},
        **{f"{CLOTH}/{name}.indices": "changed" for name in SUBSETS},
        **dict.fromkeys((CLOTH + name for name in DROPPED), "gone"),
    }
    assert compare_properties(before, after) == expected


def test_report_names_all_that_is_lost_and_nothing_else(rich):
    [prim] = rich[2].prims
    assert {line for line in prim.dropped if "closed seams" not in line} == {*DROPPED.values(), *LINES}


def test_lengths_ranges_and_times_fit(rich):
    check_stage(rich[1], rich[0])


def test_metadata_of_remapped_properties_is_kept(rich):
    before, after = (stage.GetPrimAtPath(CLOTH) for stage in rich[:2])
    for name in (*RECOMPUTED, *REMAPPED):
        had, has = metadata(before.GetAttribute(name)), metadata(after.GetAttribute(name))
        if name == "primvars:gaps":
            assert had.pop("unauthoredValuesIndex") == "2"
            assert has.pop("unauthoredValuesIndex") == "-1"
        assert has == had, name
        assert after.GetAttribute(name).GetTypeName() == before.GetAttribute(name).GetTypeName()


def test_values_that_have_no_mean_are_values_of_the_input(rich):
    for name in ("bool", "uchar", "int", "uint", "int64", "uint64", "string", "token", "asset", "int2"):
        for interpolation in LENGTHS:
            attributes = [stage.GetAttributeAtPath(f"{CLOTH}.primvars:{name}_{interpolation}") for stage in rich[:2]]
            had, has = ({str(plain(value)) for value in values_of(attribute)[0]} for attribute in attributes)
            assert has <= had, (name, interpolation)


def test_means_lie_between_the_values_of_the_input(rich):
    for name in (
        "half",
        "double",
        "timecode",
        "half3",
        "double4",
        "color4f",
        "matrix3d",
        "matrix4d",
        "sized",
        "moving",
        "indexed",
    ):
        for interpolation in LENGTHS:
            attributes = [stage.GetAttributeAtPath(f"{CLOTH}.primvars:{name}_{interpolation}") for stage in rich[:2]]
            for had, has in zip(*map(values_of, attributes), strict=True):
                had, has = (np.array(value, dtype=np.float64) for value in (had, has))
                assert has.min() >= had.min() - 1e-5 * abs(had.min()), (name, interpolation)
                assert has.max() <= had.max() + 1e-5 * abs(had.max()), (name, interpolation)


def test_blocked_samples_stay_blocked(rich):
    after = rich[1]
    assert after.GetAttributeAtPath(f"{CLOTH}.primvars:blockedOnce").Get(2.0) is None
    assert after.GetAttributeAtPath(f"{CLOTH}.primvars:blockedOnce").Get(1.0) is not None
    assert after.GetAttributeAtPath(f"{CLOTH}/moving.indices").Get(3.0) is None


def test_assets_are_found_from_the_folder_of_the_output(rich):
    for interpolation in LENGTHS:
        [values, *_] = values_of(rich[1].GetAttributeAtPath(f"{CLOTH}.primvars:asset_{interpolation}"))
        assert all(Path(value.resolvedPath).read_text() == "texture" for value in values)
        if interpolation != "constant":
            assert not any(Path(value.path).is_absolute() for value in values)


@pytest.mark.parametrize(
    ("family", "kind"), [("materialBind", "partition"), ("rooms", "nonOverlapping"), ("loose", "unrestricted")]
)
def test_families_stay_valid(rich, family, kind):
    mesh = UsdGeom.Mesh(rich[1].GetPrimAtPath(CLOTH))
    assert UsdGeom.Subset.GetFamilyType(mesh, family) == kind
    valid, reason = UsdGeom.Subset.ValidateFamily(mesh, "face", family)
    assert valid, reason


def test_stage_metadata_is_kept(rich):
    before, after = (stage.GetRootLayer().pseudoRoot for stage in rich[:2])
    for key in before.ListInfoKeys():
        if key != "primChildren":
            assert after.GetInfo(key) == before.GetInfo(key), key
