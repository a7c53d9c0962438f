"""Simplifying the meshes of a file, end to end."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom

from tests.support.usd_stages import FRAMES, cloth_stage, define_cloth, instanced_stage, skinned_stage
from warpqem.errors import DeviceError, OptionError, StageError
from warpqem.usd import FrameRange, SimplifyOptions, simplify_stage
from warpqem.usd.write.stage_report import StageReport

CLOTH = "/Root/Cloth"


def simplify(tmp_path: Path, **options: object) -> tuple[StageReport, Usd.Stage | None]:
    """Simplify in.usda; the report and the opened result."""
    options.setdefault("device", "cpu")
    if not {"ratio", "faces", "max_error"} & set(options):
        options["ratio"] = 0.5
    report = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(**options))
    return report, Usd.Stage.Open(report.output) if report.output else None


def break_mesh(stage: Usd.Stage, path: str) -> None:
    """A mesh that cannot be read: a face refers to a point that does not exist."""
    mesh = define_cloth(stage, path, times=FRAMES)
    mesh.GetFaceVertexIndicesAttr().Set([*list(mesh.GetFaceVertexIndicesAttr().Get())[:-1], 999])
    stage.Save()


def test_ratio_halves_the_triangles_of_every_frame(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    report, stage = simplify(tmp_path, ratio=0.5)
    [prim] = report.prims
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH))
    assert (prim.status, prim.stopped, prim.frames, prim.faces_before) == ("simplified", "target", 3, 128)
    assert prim.faces_after in (63, 64)
    assert len(mesh.GetFaceVertexCountsAttr().Get()) == prim.faces_after
    assert mesh.GetPointsAttr().GetTimeSamples() == FRAMES


def test_flat_and_layered_results_have_equal_points_at_every_time(tmp_path):
    skinned_stage(tmp_path / "in.usda")
    options = SimplifyOptions(ratio=0.5, device="cpu")
    simplify_stage(tmp_path / "in.usda", tmp_path / "layer.usdc", options)
    simplify_stage(tmp_path / "in.usda", tmp_path / "flat.usdc", SimplifyOptions(ratio=0.5, device="cpu", flatten=True))
    stages = [Usd.Stage.Open(str(tmp_path / name)) for name in ("layer.usdc", "flat.usdc")]
    layered, flat = (UsdGeom.Mesh(stage.GetPrimAtPath("/Char/Body")).GetPointsAttr() for stage in stages)
    for time in (Usd.TimeCode.Default(), 0.0, *FRAMES, 1.5, 9.0):
        np.testing.assert_array_equal(layered.Get(time), flat.Get(time))


def test_input_file_stays_as_it_is(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    before = (tmp_path / "in.usda").read_bytes()
    simplify(tmp_path)
    assert (tmp_path / "in.usda").read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in.usda", "out.usda"]


def test_winding_follows_the_authored_orientation(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda", times=None)
    points = UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)).GetPointsAttr()
    points.Set([Gf.Vec3f(p[0], p[1], 0.02 * p[0] * p[1]) for p in points.Get()])
    UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)).CreateOrientationAttr("leftHanded")
    stage.Save()
    _report, result = simplify(tmp_path)
    mesh = UsdGeom.Mesh(result.GetPrimAtPath(CLOTH))
    corners = np.array(mesh.GetPointsAttr().Get())[np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert mesh.GetOrientationAttr().Get() == "leftHanded"
    assert (normals[:, 2] > 0).all()


def test_mesh_that_cannot_be_read_does_not_stop_the_others(tmp_path):
    break_mesh(cloth_stage(tmp_path / "in.usda"), "/Root/Broken")
    report, stage = simplify(tmp_path)
    assert {prim.path: prim.status for prim in report.prims} == {CLOTH: "simplified", "/Root/Broken": "failed"}
    assert "/Root/Broken.faceVertexIndices" in report.failed[0].message
    assert len(UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Broken")).GetFaceVertexCountsAttr().Get()) == 64


def test_strict_stops_and_writes_nothing(tmp_path):
    break_mesh(cloth_stage(tmp_path / "in.usda"), "/Root/Broken")
    with pytest.raises(StageError, match="/Root/Broken"):
        simplify(tmp_path, strict=True)
    assert not (tmp_path / "out.usda").exists()


def test_nothing_is_written_if_all_meshes_fail(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    stage.RemovePrim(CLOTH)
    break_mesh(stage, "/Root/Broken")
    report, _stage = simplify(tmp_path)
    assert report.output is None
    assert not (tmp_path / "out.usda").exists()


def test_instance_that_cannot_be_edited_fails_and_others_are_done(tmp_path):
    stage = instanced_stage(tmp_path / "in.usda")
    for name in ("First", "Second"):
        Sdf.CreatePrimInLayer(stage.GetRootLayer(), f"/Root/{name}/Cloth").documentation = "ignored"
    stage.Save()
    report, _stage = simplify(tmp_path)
    assert [prim.status for prim in report.prims] == ["simplified", "failed"]


def test_prim_option_leaves_other_meshes_alone(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    define_cloth(stage, "/Root/Flag", times=FRAMES)
    stage.Save()
    report, result = simplify(tmp_path, prims=("/Root/Flag",))
    assert [prim.path for prim in report.prims] == ["/Root/Flag"]
    assert len(UsdGeom.Mesh(result.GetPrimAtPath(CLOTH)).GetFaceVertexCountsAttr().Get()) == 64


def test_mesh_with_nothing_to_remove_keeps_its_polygons(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    report, stage = simplify(tmp_path, ratio=1.0)
    assert report.prims[0].status == "kept"
    assert len(UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)).GetFaceVertexCountsAttr().Get()) == 64


def test_mesh_without_faces_is_kept(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    empty = UsdGeom.Mesh.Define(stage, "/Root/Empty")
    empty.CreatePointsAttr([])
    empty.CreateFaceVertexCountsAttr([])
    empty.CreateFaceVertexIndicesAttr([])
    stage.Save()
    report, _stage = simplify(tmp_path)
    assert [prim.status for prim in report.prims] == ["simplified", "kept"]


def test_frame_range_limits_the_samples_written(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    _report, stage = simplify(tmp_path, frames=FrameRange(2, 4))
    assert UsdGeom.Mesh(stage.GetPrimAtPath(CLOTH)).GetPointsAttr().GetTimeSamples() == [2.0, 4.0]


def test_max_error_stops_a_mesh_early(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    report, _stage = simplify(tmp_path, max_error=3.0)
    [prim] = report.prims
    assert prim.stopped == "max_error"
    assert prim.measured["hausdorff"] <= 3.0
    assert prim.faces_after < prim.faces_before


def closed_stage(path: Path) -> None:
    """A mesh that no collapse is legal on."""
    stage = cloth_stage(path)
    stage.RemovePrim(CLOTH)
    closed = UsdGeom.Mesh.Define(stage, "/Root/Closed")
    closed.CreatePointsAttr([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)])
    # A tetrahedron, the least closed surface that there is.
    closed.CreateFaceVertexCountsAttr([3, 3, 3, 3])
    closed.CreateFaceVertexIndicesAttr([0, 2, 1, 0, 1, 3, 1, 2, 3, 0, 3, 2])
    stage.Save()


def test_mesh_without_a_legal_collapse_is_kept(tmp_path):
    closed_stage(tmp_path / "in.usda")
    report, _stage = simplify(tmp_path, ratio=0.4, max_size_error=None)
    assert (report.prims[0].status, report.prims[0].stopped) == ("kept", "no legal collapse")


def test_strict_refuses_a_face_count_that_cannot_be_reached(tmp_path):
    closed_stage(tmp_path / "in.usda")
    with pytest.raises(StageError, match="/Root/Closed: 4 faces are left"):
        simplify(tmp_path, ratio=0.4, max_size_error=None, strict=True)


def test_budget_is_kept_and_spent_where_the_surface_bends(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda", times=None)
    flat = define_cloth(stage, "/Root/Flat")
    flat.GetPointsAttr().Set([Gf.Vec3f(p[0], p[1], 0.001 * p[0] * p[1]) for p in flat.GetPointsAttr().Get()])
    stage.Save()
    report, _stage = simplify(tmp_path, faces=100)
    after = {prim.path: prim.faces_after for prim in report.prims}
    assert 98 <= sum(after.values()) <= 100
    assert after[CLOTH] > 2 * after["/Root/Flat"]


def test_budget_weighs_meshes_by_their_size_in_the_world(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda", times=None)
    define_cloth(stage, "/Root/Small").AddScaleOp().Set(Gf.Vec3f(0.1))
    stage.Save()
    report, _stage = simplify(tmp_path, faces=120)
    after = {prim.path: prim.faces_after for prim in report.prims}
    assert after[CLOTH] > 2 * after["/Root/Small"]


def test_payload_in_another_file_is_edited_by_the_layer(tmp_path):
    define_asset = Usd.Stage.CreateNew(str(tmp_path / "asset.usda"))
    define_cloth(define_asset, "/Asset/Cloth", times=FRAMES)
    define_asset.SetDefaultPrim(define_asset.GetPrimAtPath("/Asset"))
    define_asset.Save()
    stage = cloth_stage(tmp_path / "in.usda")
    prim = stage.DefinePrim("/Root/Loaded")
    prim.GetPayloads().AddPayload("./asset.usda", layerOffset=Sdf.LayerOffset(10))
    stage.Save()
    _report, result = simplify(tmp_path, prims=("/Root/Loaded",))
    mesh = UsdGeom.Mesh(result.GetPrimAtPath("/Root/Loaded/Cloth"))
    source = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Loaded/Cloth"))
    assert mesh.GetPointsAttr().GetTimeSamples() == source.GetPointsAttr().GetTimeSamples() != FRAMES
    assert len(mesh.GetFaceVertexCountsAttr().Get()) in (63, 64)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"ratio": 25}, "for 25 % give 0.25"),
        ({"ratio": 0.0}, "ratio must be in .* got 0"),
        ({"ratio": -0.5}, "ratio must be in .* got -0.5"),
        ({"ratio": float("nan")}, "ratio must be in .* got nan"),
        ({"faces": 0}, "faces 0"),
        ({"max_error": 0.0}, "max_error must be a finite number above 0, got 0"),
        ({"ratio": 0.5, "faces": 3}, "ratio 0.5 and faces 3 exclude each other"),
        ({}, "one of ratio"),
    ],
)
def test_wrong_target_is_refused(options, message):
    with pytest.raises(OptionError, match=message):
        SimplifyOptions(**options)


def test_option_that_the_core_refuses_fails_the_run(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    with pytest.raises(OptionError, match="coherence"):
        simplify(tmp_path, coherence=2.0)


def test_device_that_does_not_exist_fails_the_run(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    with pytest.raises(DeviceError, match="cuda:77"):
        simplify(tmp_path, device="cuda:77")


def test_stage_without_a_mesh_is_refused(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    stage.RemovePrim(CLOTH)
    stage.Save()
    with pytest.raises(StageError, match="no mesh"):
        simplify(tmp_path)


def test_progress_ends_at_one_and_never_falls(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    seen: list[float] = []
    options = SimplifyOptions(ratio=0.5, device="cpu")
    simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", options, lambda fraction, text: seen.append(fraction))
    assert seen == sorted(seen)
    assert seen[-1] == 1.0
