"""A layer of a stage as the output: lists of paths come over, and a layer that an edit fails in stays as it is."""

from __future__ import annotations

import pytest
from pxr import Sdf, Usd, UsdSkel

from tests.support.usd_rig import TUBE, shaped_rig
from warpqem.errors import StageError
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.write import layer_output


def simplify(stage: Usd.Stage, layer: Sdf.Layer, **options: object) -> None:
    simplify_stage(stage, layer, SimplifyOptions(**{"ratio": 0.4, "device": "cpu", **options}))


@pytest.fixture
def stage(tmp_path) -> Usd.Stage:
    return shaped_rig(tmp_path / "in.usda")


@pytest.mark.parametrize("place", ["session", "anonymous"])
def test_targets_of_blend_shapes_come_over(stage, place):
    layer = stage.GetSessionLayer() if place == "session" else Sdf.Layer.CreateAnonymous(".usda")
    if place == "anonymous":
        stage.GetSessionLayer().subLayerPaths.append(layer.identifier)
    root = stage.GetRootLayer().ExportToString()
    simplify(stage, layer, shapes=1)
    binding = UsdSkel.BindingAPI(stage.GetPrimAtPath(TUBE))
    [name] = binding.GetBlendShapesAttr().Get()
    [target] = binding.GetBlendShapeTargetsRel().GetTargets()
    assert target.name == name
    assert stage.GetRootLayer().ExportToString() == root


def test_bake_takes_the_skeleton_off(stage):
    simplify(stage, stage.GetSessionLayer(), bake=True)
    assert not UsdSkel.BindingAPI(stage.GetPrimAtPath(TUBE)).GetSkeletonRel().GetTargets()


def test_prepended_targets_are_put_together_with_those_of_the_layer():
    edits, layer = (Sdf.Layer.CreateAnonymous(".usda") for _ in range(2))
    for each, path in ((edits, "/b"), (layer, "/a")):
        relationship = Sdf.RelationshipSpec(Sdf.CreatePrimInLayer(each, "/prim"), "rel", False)
        relationship.targetPathList.prependedItems = [path]
    layer_output.merge_edits(edits, layer, Usd.Stage.CreateInMemory())
    stage = Usd.Stage.Open(layer)
    assert stage.GetPrimAtPath("/prim").GetRelationship("rel").GetTargets() == [Sdf.Path("/b"), Sdf.Path("/a")]


def test_layer_stays_as_it_is_where_an_edit_fails(stage, monkeypatch):
    layer = stage.GetRootLayer()
    before = layer.ExportToString()
    merge = layer_output._merge

    def fails_at_the_end(edits, layer, path, to_layer):
        merge(edits, layer, path, to_layer)
        if path.name == "points":
            raise StageError("no more")

    monkeypatch.setattr(layer_output, "_merge", fails_at_the_end)
    with pytest.raises(StageError, match="no more"):
        simplify(stage, layer)
    assert layer.ExportToString() == before
