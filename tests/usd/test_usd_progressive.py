"""Progressive meshes from and to USD, and levels by their size on a screen."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from pxr import Gf, Usd, UsdGeom
from typer.testing import CliRunner

from tests.support.usd_stages import FRAMES, cloth_stage, define_cloth, skinned_stage
from warpqem.arguments.figures import rounded_up
from warpqem.cli.main import app
from warpqem.costs.screen_error import ScreenView
from warpqem.errors import OptionError, ProgressiveFileError, StageError
from warpqem.progressive import build_progressive, load, read_info, save
from warpqem.progressive.bounded_levels import measured_level
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.commands.progressive import BuildOptions, LevelChoice, build_file, extract_level
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.skeleton_poses import StagePoses

CPU = BuildOptions(device="cpu")


@pytest.fixture
def cloth(tmp_path) -> Path:
    """A file of the waving cloth, which travels in the world."""
    stage = cloth_stage(tmp_path / "in.usda")
    for time in FRAMES:
        mover = UsdGeom.Xformable(stage.GetPrimAtPath("/Root"))
        ops = mover.GetOrderedXformOps()
        (ops[0] if ops else mover.AddTranslateOp()).Set(Gf.Vec3d(10 * time, 0, 0), time)
    stage.Save()
    build_file(tmp_path / "in.usda", tmp_path / "cloth.wpqm", CPU)
    return tmp_path / "cloth.wpqm"


def world_points(path: Path, prim: str, time: float) -> np.ndarray:
    stage = Usd.Stage.Open(str(path))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(prim))
    matrix = np.array(UsdGeom.XformCache(time).GetLocalToWorldTransform(mesh.GetPrim()))
    return np.array(mesh.GetPointsAttr().Get(time)) @ matrix[:3, :3] + matrix[3, :3]


def test_finest_level_is_the_input_in_world_space(cloth):
    extract_level(cloth, cloth.with_name("out.usda"), LevelChoice(ratio=1.0))
    for time in FRAMES:
        had, has = (world_points(cloth.with_name(name), "/Root/Cloth", time) for name in ("in.usda", "out.usda"))
        np.testing.assert_allclose(np.sort(has, axis=0), np.sort(had, axis=0), atol=1e-5)


def test_level_has_the_faces_times_and_metadata_asked_for(cloth):
    out = cloth.with_name("out.usda")
    faces, error, measured = extract_level(cloth, out, LevelChoice(faces=20))
    assert measured is None
    stage = Usd.Stage.Open(str(out))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth"))
    assert len(mesh.GetFaceVertexCountsAttr().Get()) == faces
    assert faces in (19, 20)
    assert error > 0
    assert mesh.GetPointsAttr().GetTimeSamples() == FRAMES
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (FRAMES[0], FRAMES[-1])
    before = Usd.Stage.Open(str(cloth.with_name("in.usda")))
    assert UsdGeom.GetStageUpAxis(stage) == UsdGeom.GetStageUpAxis(before)
    assert UsdGeom.GetStageMetersPerUnit(stage) == UsdGeom.GetStageMetersPerUnit(before)
    assert stage.GetTimeCodesPerSecond() == before.GetTimeCodesPerSecond()
    assert stage.GetDefaultPrim().GetPath() == "/Root"


def test_skinned_mesh_becomes_its_poses(tmp_path):
    skinned_stage(tmp_path / "in.usda")
    build_file(tmp_path / "in.usda", tmp_path / "skin.wpqm", CPU)
    assert load(tmp_path / "skin.wpqm").frame_count == len(FRAMES)


def test_left_handed_mesh_keeps_its_front(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth")).CreateOrientationAttr("leftHanded")
    stage.Save()
    build_file(tmp_path / "in.usda", tmp_path / "left.wpqm", CPU)
    cloth_stage(tmp_path / "right.usda")
    build_file(tmp_path / "right.usda", tmp_path / "right.wpqm", CPU)
    left, right = (load(tmp_path / f"{name}.wpqm") for name in ("left", "right"))
    np.testing.assert_array_equal(left.level(left.split_count).faces, right.level(right.split_count).faces[:, ::-1])


def test_one_of_several_meshes_has_to_be_chosen(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    define_cloth(stage, "/Root/Other")
    stage.Save()
    with pytest.raises(OptionError, match=r"2 meshes \(/\S+, /[^ ,]+\): choose one with --prim"):
        build_file(tmp_path / "in.usda", tmp_path / "out.wpqm", CPU)
    info = build_file(tmp_path / "in.usda", tmp_path / "out.wpqm", BuildOptions(prim="/Root/Other", device="cpu"))
    assert info.extra["prim"] == "/Root/Other"


def test_input_is_never_overwritten(cloth):
    with pytest.raises(OptionError, match="never overwritten"):
        build_file(cloth.with_name("in.usda"), cloth.with_name("in.usda"), CPU)


def test_folder_that_is_not_there_is_an_error(cloth):
    with pytest.raises(StageError, match="cannot be written"):
        build_file(cloth.with_name("in.usda"), cloth.parent / "none" / "out.wpqm", CPU)


def test_file_that_was_not_built_from_usd_is_named(tmp_path, cloth):
    save(build_progressive(*cloth_arrays(), device="cpu"), tmp_path / "plain.wpqm")
    with pytest.raises(ProgressiveFileError, match=r"plain\.wpqm: there is no stage in it"):
        extract_level(tmp_path / "plain.wpqm", tmp_path / "out.usda", LevelChoice(ratio=0.5))


def cloth_arrays() -> tuple[np.ndarray, np.ndarray]:
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float32)
    return points, np.array([[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize("options", [{}, {"ratio": 0.5, "faces": 3}])
def test_exactly_one_choice_of_a_level(options):
    with pytest.raises(OptionError, match="exactly one"):
        LevelChoice(**options)


def test_pixel_at_a_distance_covers_its_share_of_the_picture():
    # A right angle at distance 1 sees a height of 2.
    assert ScreenView(1.0, 1.0, 90.0, 1000).length == pytest.approx(0.002)
    assert ScreenView(3.0, 5.0, 90.0, 1000).length == pytest.approx(0.03)


@pytest.mark.parametrize(
    "view",
    [
        {"error": 0.0, "distance": 1.0},
        {"error": 1.0, "distance": -1.0},
        {"error": 1.0, "distance": 1.0, "field_of_view": 180.0},
        {"error": 1.0, "distance": 1.0, "image_height": 0},
        {"error": float("nan"), "distance": 1.0},
    ],
)
def test_views_that_show_nothing_are_refused(view):
    with pytest.raises(OptionError, match="must be"):
        ScreenView(**view)


def test_farther_camera_gives_fewer_faces_within_its_error(cloth):
    info, counts = read_info(cloth), []
    for distance in (500.0, 2000.0):
        view = ScreenView(2.0, distance)
        level = extract_level(cloth, cloth.with_name("out.usda"), LevelChoice(screen=view))
        assert level.measured.hausdorff_length <= 1.2 * view.length
        counts.append(level.faces)
    assert counts[1] < counts[0] < info.face_count


def test_screen_error_limits_the_error_in_world_units(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    UsdGeom.Xformable(stage.GetPrimAtPath("/Root")).AddScaleOp().Set(Gf.Vec3f(3))
    stage.Save()
    view = ScreenView(4.0, 400.0)
    report = simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(screen=view, device="cpu"))
    [prim] = report.prims
    points = np.array(UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth")).GetPointsAttr().Get(FRAMES[0]))
    assert prim.stopped == "max_error"
    limit = 100 * view.length / (3 * np.linalg.norm(np.ptp(points, axis=0)))
    assert 0.2 * limit < prim.measured["hausdorff"] <= 1.2 * limit


def test_commands_build_extract_and_describe(cloth):
    runner, folder = CliRunner(), cloth.parent
    made = runner.invoke(
        app, ["progressive", "build", str(folder / "in.usda"), "-o", str(folder / "b.wpqm"), "--device", "cpu"]
    )
    assert made.exit_code == 0, made.output
    options = ["--screen-error", "2", "--distance", "300", "--json", str(folder / "level.json")]
    taken = runner.invoke(
        app, ["progressive", "extract", str(folder / "b.wpqm"), "-o", str(folder / "b.usda"), *options]
    )
    assert taken.exit_code == 0, taken.output
    level = json.loads((folder / "level.json").read_text())
    assert 0 < level["faces"] < read_info(cloth).face_count
    shown = runner.invoke(app, ["progressive", "info", str(folder / "b.wpqm")])
    assert shown.exit_code == 0
    assert "base faces" in shown.output


@pytest.mark.parametrize("options", [["--screen-error", "2"], ["--distance", "3"]])
def test_half_a_view_is_wrong_usage(cloth, options):
    arguments = ["progressive", "extract", str(cloth), "-o", str(cloth.with_name("o.usda")), *options]
    result = CliRunner().invoke(app, arguments)
    assert isinstance(result.exception, (OptionError, SystemExit))
    assert result.exit_code != 0


@pytest.mark.parametrize("options", [{"ratio": 0.5}, {"refit": True}, {"keep_components": True}])
def test_options_without_a_meaning_for_all_levels_are_refused(options):
    with pytest.raises(OptionError, match=f"{next(iter(options))}.*which has all levels"):
        BuildOptions(device="cpu", **options)


@pytest.mark.parametrize("limit", [2.0, 6.0, 15.0])
def test_error_that_is_printed_for_a_level_holds_in_all_frames(cloth, limit):
    folder = cloth.parent
    options = ["--max-error", str(limit), "--json", str(folder / "level.json")]
    shown = CliRunner().invoke(app, ["progressive", "extract", str(cloth), "-o", str(folder / "out.usda"), *options])
    assert shown.exit_code == 0, shown.output
    level = json.loads((folder / "level.json").read_text())
    printed = float(rounded_up(level["measured"]["hausdorff"]))
    assert rounded_up(level["measured"]["hausdorff"]) in shown.output
    assert printed <= limit
    # By trimesh, of many samples in each frame.
    for time in FRAMES:
        one, other = (surface(folder / name, time) for name in ("in.usda", "out.usda"))
        diagonal = np.linalg.norm(np.ptp(one.vertices, axis=0))
        for own, of in ((one, other), (other, one)):
            spots = np.concatenate([own.vertices, trimesh.sample.sample_surface(own, 2000, seed=1)[0]])
            _, away, _ = trimesh.proximity.closest_point_naive(of, spots)
            assert 100 * away.max() / diagonal <= printed
    # No coarser one holds.
    mesh = load(cloth)
    coarser = mesh.splits_for(target_faces=level["faces"]) - 1
    if coarser >= 0:
        assert measured_level(mesh, mesh.level(coarser), device="cpu").hausdorff > 0.998 * limit


def surface(path: Path, time: float) -> trimesh.Trimesh:
    stage = Usd.Stage.Open(str(path))
    prim = stage.GetPrimAtPath("/Root/Cloth")
    faces = MeshSource(prim, StagePoses(stage)).topology.triangles
    return trimesh.Trimesh(world_points(path, "/Root/Cloth", time), faces, process=False)
