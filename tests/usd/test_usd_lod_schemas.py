"""Levels of detail with the UsdLod schemas, end to end."""

from __future__ import annotations

from pathlib import Path

import pytest
from pxr import Gf, Kind, Sdf, Usd, UsdGeom

from tests.support.usd_lods import GALLOP, LEVELS, build_levels, properties, run
from tests.support.usd_stages import cloth_stage, define_cloth, skinned_stage
from warpqem.errors import OptionError
from warpqem.usd import FrameRange, SimplifyOptions, simplify_stage

UsdLod = pytest.importorskip("pxr.UsdLod", reason="UsdLod is part of USD from 26.08 on")


def build(source: Path, output: Path, **options: object) -> Usd.Stage:
    report = build_levels(source, output, usd_lod=True, **options)
    assert {prim.status for prim in report.prims} == {"simplified"}
    return Usd.Stage.Open(str(output))


def below(stage: Usd.Stage, root: str) -> dict[str, list[object]]:
    """What a prim composes to, itself and all below, with paths and targets as seen from it."""
    return {
        path[len(root) :]: [
            [str(target).replace(root, "", 1) for target in value]
            if isinstance(value, list) and value and isinstance(value[0], Sdf.Path)
            else value
            for value in values
        ]
        for path, values in properties(stage).items()
        if path.startswith((root + "/", root + ".")) or path == root
    }


def thresholds(stage: Usd.Stage) -> tuple[list[float], list[float]]:
    prims = [
        stage.GetPrimAtPath(stage.GetDefaultPrim().GetPath().AppendChild(n)) for n in ("LODScreenSize", "LODDistance")
    ]
    return list(UsdLod.ScreenSizeHeuristic(prims[0]).GetThresholdsAttr().Get()), list(
        UsdLod.DistanceHeuristic(prims[1]).GetThresholdsAttr().Get()
    )


@pytest.mark.parametrize("make", [cloth_stage, skinned_stage])
def test_every_level_equals_a_plain_run(make, tmp_path):
    stage = make(tmp_path / "in.usda")
    root = next(iter(stage.GetPseudoRoot().GetChildren())).GetPath().pathString
    result = build(tmp_path / "in.usda", tmp_path / "lods.usda")
    assert below(result, f"{root}/LOD/LOD0") == below(Usd.Stage.Open(str(tmp_path / "in.usda")), root)
    for level, ratio in LEVELS:
        simplify_stage(tmp_path / "in.usda", tmp_path / "plain.usda", SimplifyOptions(ratio=ratio, device="cpu"))
        assert below(result, f"{root}/LOD/LOD{level}") == below(Usd.Stage.Open(str(tmp_path / "plain.usda")), root)
        (tmp_path / "plain.usda").unlink()


def test_children_of_the_lod_root_are_the_levels_and_nothing_else(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    stage = build(tmp_path / "in.usda", tmp_path / "lods.usdc")
    [root] = [prim for prim in stage.Traverse() if prim.HasAPI(UsdLod.RootAPI)]
    assert [child.GetName() for child in root.GetChildren()] == ["LOD0", "LOD1", "LOD2"]
    assert UsdLod.RootAPI(root).GetLodDefaultIndexAttr().Get() == 0
    targets = UsdLod.RootAPI(root).GetLodHeuristicsRel().GetTargets()
    assert [stage.GetPrimAtPath(path).GetTypeName() for path in targets] == [
        "LODScreenSizeHeuristic", "LODDistanceHeuristic"
    ]  # fmt: skip
    assert stage.GetDefaultPrim().GetPath() == "/Root"
    assert stage.GetCompositionErrors() == []


def test_both_heuristics_choose_the_same_level_for_the_fallback_camera(tmp_path):
    cloth_stage(tmp_path / "in.usda", times=None)
    stage = build(tmp_path / "in.usda", tmp_path / "lods.usda")
    by_size = UsdLod.ScreenSizeHeuristic(stage.GetPrimAtPath("/Root/LODScreenSize"))
    by_distance = UsdLod.DistanceHeuristic(stage.GetPrimAtPath("/Root/LODDistance"))
    levels = []
    for distance in (35.0, 45.0, 70.0):
        frustum = UsdGeom.Camera.Define(stage, "/Camera").GetCamera(Usd.TimeCode.Default()).frustum
        frustum.SetPosition(Gf.Vec3d(*by_distance.GetCenterAttr().Get()) + Gf.Vec3d(0, 0, distance))
        place = (Gf.Matrix4d(1), Usd.TimeCode.Default())
        levels.append(by_size.ComputeLOD(frustum, *place))
        assert by_distance.ComputeLOD(frustum.GetPosition(), *place) == levels[-1]
    assert levels == [0, 1, 2]


def test_thresholds_follow_the_share_of_the_faces(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    report = build_levels(tmp_path / "in.usda", tmp_path / "lods.usda", usd_lod=True)
    sizes, distances = thresholds(Usd.Stage.Open(str(tmp_path / "lods.usda")))
    assert sizes == pytest.approx([prim.faces_after / prim.faces_before for prim in report.prims])
    assert distances[1] / distances[0] == pytest.approx((sizes[0] / sizes[1]) ** 0.5)


def test_boxes_of_the_heuristics_follow_the_motion(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    UsdGeom.Xformable(stage.GetPrimAtPath("/Root")).AddTranslateOp().Set(Gf.Vec3d(0, 0, 0), 1.0)
    UsdGeom.XformOp(stage.GetPrimAtPath("/Root").GetAttribute("xformOp:translate")).Set(Gf.Vec3d(30, 0, 0), 4.0)
    stage.Save()
    result = build(tmp_path / "in.usda", tmp_path / "lods.usda")
    extent = UsdLod.ScreenSizeHeuristic(result.GetPrimAtPath("/Root/LODScreenSize")).GetExtentAttr()
    for time in (1.0, 2.0, 4.0):
        cache = UsdGeom.BBoxCache(Usd.TimeCode(time), ["default"])
        box = cache.ComputeWorldBound(result.GetPrimAtPath("/Root/LOD/LOD0")).ComputeAlignedRange()
        for found, expected in zip(extent.Get(time), (box.GetMin(), box.GetMax()), strict=True):
            assert list(found) == pytest.approx(list(expected), abs=1e-5)
    assert extent.Get() == extent.Get(1.0)


@pytest.mark.parametrize(
    ("kind", "levels", "item"),
    [("component", "", "subcomponent"), ("assembly", "group", "assembly"), ("group", "group", "group"), ("", "", "")],
)
def test_model_hierarchy_stays_whole(kind, levels, item, tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    Usd.ModelAPI(stage.GetPrimAtPath("/Root")).SetKind(kind) if kind else None
    stage.Save()
    result = build(tmp_path / "in.usda", tmp_path / "lods.usda")
    kinds = [Usd.ModelAPI(result.GetPrimAtPath(path)).GetKind() for path in ("/Root", "/Root/LOD", "/Root/LOD/LOD1")]
    assert kinds == [kind, levels, item]
    assert result.GetPrimAtPath("/Root").IsModel() == bool(kind)
    assert result.GetPrimAtPath("/Root/LOD/LOD1").IsModel() == Kind.Registry.IsA(kind, "group")


def test_levels_come_along_by_a_reference_to_the_output(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    build(tmp_path / "in.usda", tmp_path / "lods.usda")
    scene = Usd.Stage.CreateInMemory()
    scene.DefinePrim("/Set/Prop").GetReferences().AddReference(str(tmp_path / "lods.usda"))
    root = UsdLod.RootAPI(scene.GetPrimAtPath("/Set/Prop/LOD"))
    assert [path.pathString for path in root.GetLodHeuristicsRel().GetTargets()] == [
        "/Set/Prop/LODScreenSize", "/Set/Prop/LODDistance"
    ]  # fmt: skip


def test_default_prim_that_is_a_mesh_gets_levels(tmp_path):
    stage = Usd.Stage.CreateNew(str(tmp_path / "in.usda"))
    stage.SetDefaultPrim(define_cloth(stage, "/Cloth").GetPrim())
    stage.Save()
    result = build(tmp_path / "in.usda", tmp_path / "lods.usda")
    assert [prim.GetTypeName() for prim in result.GetPrimAtPath("/Cloth/LOD").GetChildren()] == ["Mesh"] * 3


def test_gallop_gets_levels_that_all_are_skinned(tmp_path):
    start = Usd.Stage.Open(str(GALLOP)).GetStartTimeCode()
    stage = build(GALLOP, tmp_path / "lods.usda", key_frames=2, frames=FrameRange(start, start + 1))
    meshes = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
    assert len(meshes) == 3
    for level, prim in enumerate(meshes):
        [skeleton] = (
            prim.GetRelationship("skel:skeleton").GetTargets()
            or UsdGeom.Imageable(prim.GetParent()).GetPrim().GetRelationship("skel:skeleton").GetTargets()
        )
        assert f"/LOD/LOD{level}/" in skeleton.pathString


def test_box_of_nothing_is_refused(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    UsdGeom.Imageable(stage.GetPrimAtPath("/Root")).CreatePurposeAttr("guide")
    stage.Save()
    with pytest.raises(OptionError, match="/Root has no bounding box at time 1"):
        build_levels(tmp_path / "in.usda", tmp_path / "lods.usda", usd_lod=True)


def test_usd_lod_without_ratios_is_wrong_usage(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    result = run("simplify", tmp_path / "in.usda", "-o", tmp_path / "out.usda", "--usd-lod", "--ratio", "0.5")
    assert result.exit_code == 2
    assert "--usd-lod needs --lods" in result.stderr


def test_command_line_writes_the_schemas(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    files = ("simplify", tmp_path / "in.usda", "-o", tmp_path / "out.usda")
    assert run(*files, "--lods", "0.5,0.2", "--usd-lod", "--device", "cpu").exit_code == 0
    assert Usd.Stage.Open(str(tmp_path / "out.usda")).GetPrimAtPath("/Root/LOD").HasAPI(UsdLod.RootAPI)
