"""Face subsets of the simplified mesh."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdShade

from tests.support.usd_findings import usd_findings
from tests.support.usd_stages import cloth_stage
from tests.support.usd_topology_runs import capture
from tests.support.usd_validators import new_findings
from warpqem.usd import SimplifyOptions, simplify_stage

CLOTH = "/Root/Cloth"


def halved(tmp_path: Path, flatten: bool = False, family_type: str = "partition") -> tuple[Usd.Stage, list[str]]:
    """A cloth of two materials, left and right, simplified."""
    stage = cloth_stage(tmp_path / "in.usda")
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH))
    for name, faces in (("left", range(0, 64, 2)), ("right", range(1, 64, 2))):
        members = [face // 8 * 8 + face % 8 // 2 + (4 if name == "right" else 0) for face in faces]
        subset = UsdGeom.Subset.CreateGeomSubset(mesh, name, "face", members, "materialBind", family_type)
        material = UsdShade.Material.Define(stage, f"/Root/Paint_{name}")
        UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(material)
    UsdGeom.Subset.CreateGeomSubset(mesh, "pins", "point", [0, 80], "pins", "unrestricted")
    stage.Save()
    options = SimplifyOptions(ratio=0.4, device="cpu", flatten=flatten)
    report = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options)
    return Usd.Stage.Open(str(tmp_path / "out.usda")), report.prims[0].dropped


def test_partition_stays_valid(tmp_path, flatten):
    stage, _dropped = halved(tmp_path, flatten)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH))
    assert UsdGeom.Subset.GetFamilyType(mesh, "materialBind") == "partition"
    valid, reason = UsdGeom.Subset.ValidateFamily(mesh, "face", "materialBind")
    assert valid, reason


def test_subset_covers_the_part_it_covered(tmp_path):
    stage, _dropped = halved(tmp_path)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH))
    points = np.array(mesh.GetPointsAttr().Get(1.0))
    corners = points[np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)]
    left = np.zeros(len(corners), dtype=bool)
    left[list(UsdGeom.Subset(stage.GetPrimAtPath(f"{CLOTH}/left")).GetIndicesAttr().Get())] = True
    assert (left == (corners[:, :, 0].mean(axis=1) < 4)).all()


def test_subset_keeps_its_material(tmp_path, flatten):
    stage, _dropped = halved(tmp_path, flatten)
    binding = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath(f"{CLOTH}/right"))
    assert binding.ComputeBoundMaterial()[0].GetPath() == "/Root/Paint_right"


def test_subset_of_points_is_dropped_by_name(tmp_path, flatten):
    stage, dropped = halved(tmp_path, flatten)
    subsets = UsdGeom.Subset.GetAllGeomSubsets(UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)))
    names = [subset.GetPrim().GetName() for subset in subsets]
    assert names == ["left", "right"]
    assert dropped == ["1 GeomSubset of points or edges"]


def test_subset_that_has_no_face_left_is_named(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda", times=None)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH))
    # One quad in the middle and a corner: too small to be kept at a twentieth.
    for name, faces in (("spot", [27]), ("empty", []), ("most", [face for face in range(64) if face != 27])):
        UsdGeom.Subset.CreateGeomSubset(mesh, name, "face", faces, "materialBind", "nonOverlapping")
    stage.Save()
    options = SimplifyOptions(ratio=0.05, device="cpu", max_size_error=math.inf)
    [prim] = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options).prims
    result = Usd.Stage.Open(str(tmp_path / "out.usda"))
    assert len(UsdGeom.Subset(result.GetPrimAtPath(f"{CLOTH}/spot")).GetIndicesAttr().Get()) == 0
    assert "all faces of GeomSubset spot" in prim.dropped


def cloth_with_spots(tmp_path: Path, spots: dict[str, list[int]], family_type: str, **options) -> Usd.Stage:
    """A cloth with subsets of some faces, simplified so far that nothing is left of a single face."""
    stage = cloth_stage(tmp_path / "in.usda")
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH))
    for name, faces in spots.items():
        UsdGeom.Subset.CreateGeomSubset(mesh, name, "face", faces, "materialBind", family_type)
    stage.Save()
    simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(ratio=0.06, device="cpu", **options))
    return Usd.Stage.Open(str(tmp_path / "out.usda"))


@pytest.mark.parametrize("family_type", ["nonOverlapping", "unrestricted"])
def test_family_that_loses_its_last_face_is_no_longer_there(tmp_path, family_type, flatten):
    stage = cloth_with_spots(tmp_path, {"spot": [27]}, family_type, flatten=flatten)
    spot = stage.GetPrimAtPath(f"{CLOTH}/spot")
    assert not spot.IsActive() if spot else flatten
    assert new_findings(tmp_path / "in.usda", tmp_path / "out.usda", usd_findings) == {}


def test_subset_of_no_family_stays_when_it_loses_its_last_face(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    spot = UsdGeom.Subset.Define(stage, f"{CLOTH}/spot")
    spot.CreateElementTypeAttr("face")
    spot.CreateIndicesAttr([27])
    stage.Save()
    simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(ratio=0.06, device="cpu"))
    result = Usd.Stage.Open(str(tmp_path / "out.usda"))
    spot = UsdGeom.Subset(result.GetPrimAtPath(f"{CLOTH}/spot"))
    assert spot.GetPrim().IsActive()
    assert len(spot.GetIndicesAttr().Get()) == 0
    assert new_findings(tmp_path / "in.usda", tmp_path / "out.usda", usd_findings) == {}


def test_subset_without_faces_stays_where_its_family_has_some(tmp_path):
    stage = cloth_with_spots(tmp_path, {"spot": [27], "rest": [*range(27), *range(28, 64)]}, "partition")
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH))
    assert len(UsdGeom.Subset(stage.GetPrimAtPath(f"{CLOTH}/spot")).GetIndicesAttr().Get()) == 0
    valid, reason = UsdGeom.Subset.ValidateFamily(mesh, "face", "materialBind")
    assert valid, reason


@pytest.mark.parametrize(("second", "stays"), [([0, 1, 2, 3, 4, 5], True), ([12], False)])
def test_family_over_several_topologies_is_there_where_one_of_them_has_a_face_of_it(tmp_path, second, stays):
    mesh = capture(tmp_path / "in.usda", [6, 5], 2)
    half = UsdGeom.Subset(mesh.GetPrim().GetChild("half"))
    half.GetIndicesAttr().Set([12], 0.0)
    half.GetIndicesAttr().Set(second, 2.0)
    mesh.GetPrim().GetStage().Save()
    simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(ratio=0.1, device="cpu"))
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    half = UsdGeom.Subset(stage.GetPrimAtPath("/Root/Capture/half"))
    assert half.GetPrim().IsActive() == stays
    if stays:
        assert len(half.GetIndicesAttr().Get(0.0)) == 0 < len(half.GetIndicesAttr().Get(2.0))
