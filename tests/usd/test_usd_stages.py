"""Stages for the tests of the USD layer and the command line, and tests of finding meshes on them."""

from __future__ import annotations

import pytest
from pxr import Gf, Sdf, Usd, UsdGeom

from tests.support.usd_stages import (
    cloth_stage,
    define_cloth,
    instanced_stage,
)
from warpqem.errors import StageError
from warpqem.usd.read.open_stage import find_meshes, open_stage, world_scale


def test_missing_file_is_a_stage_error(tmp_path):
    with pytest.raises(StageError, match="no such file"):
        open_stage(tmp_path / "none.usda")


def test_unreadable_file_is_one_line(tmp_path):
    path = tmp_path / "broken.usda"
    path.write_text("#usda 1.0\ndef {")
    with pytest.raises(StageError) as caught:
        open_stage(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_meshes_below_a_prim_path_are_found():
    stage = cloth_stage()
    define_cloth(stage, "/Root/Group/Flag")
    selection = find_meshes(stage, ["/Root/Group"])
    assert [str(prim.GetPath()) for prim in selection.prims] == ["/Root/Group/Flag"]


def test_overlapping_prim_paths_give_a_mesh_once():
    assert len(find_meshes(cloth_stage(), ["/Root", "/Root/Cloth"]).prims) == 1


@pytest.mark.parametrize("path", ["/Nowhere", "Root", "/Root.x", "/Root/Empty"])
def test_wrong_prim_path_is_refused(path):
    stage = cloth_stage()
    UsdGeom.Xform.Define(stage, "/Root/Empty")
    with pytest.raises(StageError, match=path):
        find_meshes(stage, [path])


def test_one_instance_is_opened_for_each_prototype(tmp_path):
    stage = instanced_stage(tmp_path / "instances.usda")
    before = stage.GetRootLayer().ExportToString()
    selection = find_meshes(stage)
    assert [str(prim.GetPath()) for prim in selection.prims] == ["/Root/Cloth", "/Root/First/Cloth"]
    assert selection.refused == []
    [shared] = selection.shared
    assert (str(shared.path), list(map(str, shared.users))) == ("/Root/First", ["/Root/First", "/Root/Second"])
    assert stage.GetRootLayer().ExportToString() == before


def test_instances_whose_ignored_opinions_would_show_are_refused(tmp_path):
    stage = instanced_stage(tmp_path / "instances.usda")
    for name in ("First", "Second"):
        Sdf.CreatePrimInLayer(stage.GetRootLayer(), f"/Root/{name}/Cloth").documentation = "ignored"
    [(path, error)] = find_meshes(stage).refused
    assert path == "/Root/First/Cloth"
    assert "shared by 2 instances" in str(error)
    assert "opinions or clips below the instance /Root/First " in str(error)


def test_class_is_edited_in_place_of_its_instances(tmp_path):
    selection = find_meshes(instanced_stage(tmp_path / "instances.usda", local=True))
    assert [str(prim.GetPath()) for prim in selection.prims] == ["/Root/Cloth", "/Asset/Cloth"]
    assert selection.refused == []


def test_class_outside_the_chosen_prims_is_left_alone(tmp_path):
    selection = find_meshes(instanced_stage(tmp_path / "instances.usda", local=True), ["/Root"])
    assert [str(prim.GetPath()) for prim in selection.prims] == ["/Root/Cloth", "/Root/First/Cloth"]


def test_world_scale_is_the_cube_root_of_the_volume_ratio():
    stage = cloth_stage()
    UsdGeom.Xformable(stage.GetPrimAtPath("/Root")).AddScaleOp().Set(Gf.Vec3f(2, 4, 1))
    assert world_scale(stage.GetPrimAtPath("/Root/Cloth"), Usd.TimeCode.Default()) == pytest.approx(2.0)
