"""The commands for faces."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pxr import Sdf, Usd, UsdGeom, Vt
from typer.testing import CliRunner

from tests.support.faces import SCENE
from warpqem.cli.main import app
from warpqem.errors import OptionError
from warpqem.usd import FrameRange, SimplifyOptions, simplify_stage
from warpqem.usd.commands.face import FaceOptions, read_face
from warpqem.usd.write.feature_subsets import feature_primvars, feature_subsets


def run(*arguments: str) -> None:
    result = CliRunner().invoke(app, ["face", *arguments])
    assert result.exit_code == 0, result.output


def test_detect_writes_points_that_it_takes_again(tmp_path: Path) -> None:
    first, picture = tmp_path / "points.json", tmp_path / "points.png"
    run("detect", str(SCENE), "-o", str(first), "--picture", str(picture), "--frames", "1:48:12")
    written = json.loads(first.read_text())
    assert len(written["points"]) >= 26
    assert Image.open(picture).size == (3 * 640, 720)
    written["points"]["chin"]["point"] = 17
    first.write_text(json.dumps(written))
    again = tmp_path / "again.json"
    run("detect", str(SCENE), "-o", str(again), "--points", str(first), "--frames", "1:1")
    assert json.loads(again.read_text())["points"]["chin"]["point"] == 17


def test_retarget_moves_a_level_as_the_face_moves(tmp_path: Path) -> None:
    level, moving = tmp_path / "level.usda", tmp_path / "moving.usdc"
    run("simplify", str(SCENE), "-o", str(level), "--faces", "2000", "--frames", "1:25:12")
    run("retarget", str(SCENE), str(level), "-o", str(moving), "--frames", "1:25:12")
    stage = Usd.Stage.Open(str(moving))
    points = UsdGeom.Mesh(stage.GetPrimAtPath("/Head/Mesh")).GetPointsAttr()
    assert points.GetTimeSamples() == [1.0, 13.0, 25.0]
    motion = np.array(points.Get(25.0)) - np.array(points.Get(1.0))
    assert np.linalg.norm(motion, axis=1).max() > 1.0


def test_blend_shapes_show_the_same_as_points_over_time(tmp_path: Path) -> None:
    files = tmp_path / "points.usdc", tmp_path / "shapes.usdc"
    for file, options in zip(files, ([], ["--blend-shapes"]), strict=True):
        run("retarget", str(SCENE), str(SCENE), "-o", str(file), "--frames", "1:25:12", *options)
    points, shapes = (read_face(file).points for file in files)
    assert points.shape == shapes.shape == (3, 5542, 3)
    assert np.abs(points - shapes).max() < 2e-3


def test_point_subsets_of_the_family_face_name_points(tmp_path: Path) -> None:
    stage = Usd.Stage.CreateNew(str(tmp_path / "named.usda"))
    stage.GetRootLayer().subLayerPaths.append(str(SCENE))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Head/Mesh"))
    UsdGeom.Subset.CreateGeomSubset(mesh, "nose_tip", UsdGeom.Tokens.point, Vt.IntArray([23]), "face")
    stage.Save()
    found = read_face(tmp_path / "named.usda")
    assert found.used[found.features.vertices["nose_tip"]] == 23
    UsdGeom.Subset.CreateGeomSubset(mesh, "tail", UsdGeom.Tokens.point, Vt.IntArray([3]), "face")
    stage.Save()
    with pytest.raises(OptionError, match="tail"):
        read_face(tmp_path / "named.usda")


@pytest.mark.parametrize("text", ["{", "[]", '{"chin": 1.5}', '{"chin": 99999999}', '{"tail": 3}'])
def test_wrong_points_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "points.json"
    path.write_text(text)
    with pytest.raises(OptionError):
        read_face(SCENE, FaceOptions(points=path))


def edited_scene(path: Path, edit: Callable[[UsdGeom.Mesh], None]) -> Path:
    """The talking head with some edits of its mesh in a layer over it."""
    stage = Usd.Stage.CreateNew(str(path))
    stage.GetRootLayer().subLayerPaths.append(str(SCENE))
    stage.SetDefaultPrim(stage.GetPrimAtPath("/Head"))
    edit(UsdGeom.Mesh(stage.GetPrimAtPath("/Head/Mesh")))
    stage.Save()
    return path


def name_chin(mesh: UsdGeom.Mesh, point: int) -> None:
    UsdGeom.Subset.CreateGeomSubset(mesh, "chin", UsdGeom.Tokens.point, Vt.IntArray([point]), "face")


def chin_primvar(mesh: UsdGeom.Mesh, point: int) -> None:
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("face:chin", Sdf.ValueTypeNames.Int, UsdGeom.Tokens.constant)
    primvar.Set(point)


def read_mesh(path: Path) -> tuple[Usd.Stage, UsdGeom.Mesh]:
    """The mesh of a file, and its stage, which has to live as long."""
    stage = Usd.Stage.Open(str(path))
    return stage, UsdGeom.Mesh(stage.GetPrimAtPath("/Head/Mesh"))


def named_points(path: Path) -> dict[str, tuple[float, ...]]:
    """Where the points that the mesh of a file names lie, in the first pose."""
    face = read_face(path, FaceOptions(frames=FrameRange(1, 1)))
    subsets = feature_subsets(face.stage.GetPrimAtPath(face.path))
    place = {int(point): index for index, point in enumerate(face.used)}
    return {name: face.points[0, place[int(subset.GetIndicesAttr().Get()[0])]] for name, subset in subsets.items()}


@pytest.mark.parametrize("give", ["file", "subset", "primvar"])
def test_simplify_keeps_the_points_that_are_given(tmp_path: Path, give: str) -> None:
    chosen = 2000
    source, more = SCENE, []
    if give == "file":
        (tmp_path / "points.json").write_text(json.dumps({"chin": chosen}))
        more = ["--points", str(tmp_path / "points.json")]
    else:
        author = name_chin if give == "subset" else chin_primvar
        source = edited_scene(tmp_path / "named.usda", lambda mesh: author(mesh, chosen))
    output = tmp_path / "level.usda"
    run("simplify", str(source), "-o", str(output), "--faces", "1000", "--frames", "1:25:12", *more)
    face = read_face(SCENE, FaceOptions(frames=FrameRange(1, 1)))
    at = face.points[0, np.flatnonzero(face.used == chosen)[0]]
    # The fit of the skin moves points by less than this.
    assert np.linalg.norm(named_points(output)["chin"] - at) < 0.02
    if give == "primvar":
        _stage, level = read_mesh(output)
        subset = feature_subsets(level.GetPrim())["chin"].GetIndicesAttr().Get()[0]
        assert feature_primvars(level.GetPrim())["chin"].Get() == subset != chosen


def test_levels_name_their_feature_points(tmp_path: Path) -> None:
    output = tmp_path / "level.usda"
    run("simplify", str(SCENE), "-o", str(output), "--faces", "700", "--frames", "1:48:12", "--weight", "20")
    found = read_face(SCENE, FaceOptions(frames=FrameRange(1, 48, 12)))
    named = named_points(output)
    assert named.keys() == found.features.vertices.keys()
    for name, vertex in found.features.vertices.items():
        assert np.linalg.norm(named[name] - found.points[0, vertex]) < 0.02 * found.features.face_height(
            found.points[0]
        )


def test_another_cost_model_moves_the_points_that_the_mesh_names(tmp_path: Path) -> None:
    source = edited_scene(tmp_path / "named.usda", lambda mesh: (name_chin(mesh, 2000), chin_primvar(mesh, 2000)))
    output = tmp_path / "level.usda"
    result = CliRunner().invoke(app, ["simplify", str(source), "-o", str(output), "--faces", "1000", "--frames", "1:1"])
    assert result.exit_code == 0, result.output
    assert "GeomSubset" not in result.output
    _stage, mesh = read_mesh(output)
    level = mesh.GetPrim()
    face = read_face(SCENE, FaceOptions(frames=FrameRange(1, 1)))
    at = face.points[0, np.flatnonzero(face.used == 2000)[0]]
    assert np.linalg.norm(named_points(output)["chin"] - at) < 1.5
    assert list(feature_subsets(level)) == ["chin"]
    assert feature_primvars(level)["chin"].Get() == feature_subsets(level)["chin"].GetIndicesAttr().Get()[0]


def test_rings_and_weights_decide_the_level(tmp_path: Path) -> None:
    levels = []
    for options in ([], ["--no-keep", "--weight", "1", "--ring", "0"]):
        output = tmp_path / f"level{len(levels)}.usda"
        run("simplify", str(SCENE), "-o", str(output), "--faces", "700", "--frames", "1:25:24", *options)
        _stage, mesh = read_mesh(output)
        levels.append(np.array(mesh.GetPointsAttr().Get()))
    assert levels[0].shape != levels[1].shape or not np.array_equal(*levels)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--ring", "-1"], "ring"),
        (["--weight", "0.5"], "weight"),
        (["--weight", "nan"], "weight"),
        (["--points", "missing.json"], "missing.json"),
    ],
)
def test_wrong_options_of_faces_are_named(tmp_path: Path, arguments: list[str], message: str) -> None:
    output = tmp_path / "out.usda"
    result = CliRunner().invoke(app, ["face", "simplify", str(SCENE), "-o", str(output), "--faces", "900", *arguments])
    assert result.exit_code != 0
    assert message in str(result.exception) + result.output
    assert not output.exists()


def test_points_of_a_mesh_that_is_not_there_are_refused(tmp_path: Path) -> None:
    (tmp_path / "points.json").write_text(json.dumps({"prim": "/Head/Other", "points": {"chin": 3}}))
    options = SimplifyOptions(ratio=0.5, metric="face", face_points=tmp_path / "points.json")
    with pytest.raises(OptionError, match="/Head/Other"):
        simplify_stage(SCENE, tmp_path / "out.usda", options)


@pytest.mark.parametrize(
    "value", [{"face_points": "p.json"}, {"face_weight": 3.0}, {"face_ring": 2}, {"face_keep": False}]
)
def test_options_of_faces_need_the_metric(value: dict[str, object]) -> None:
    with pytest.raises(OptionError, match=f"{next(iter(value))}: needs metric 'face'"):
        SimplifyOptions(ratio=0.5, **value)


def test_texture_coordinates_count_for_faces_alone() -> None:
    assert SimplifyOptions(ratio=0.5, metric="face").texture_weight == 0.1
    assert SimplifyOptions(ratio=0.5, metric="face", uv_weight=0.0).texture_weight == 0.0
    assert SimplifyOptions(ratio=0.5).texture_weight == 0.0


def test_texture_coordinates_have_a_part_by_default(tmp_path: Path) -> None:
    def stretch(mesh: UsdGeom.Mesh) -> None:
        points = np.array(mesh.GetPointsAttr().Get())
        api = UsdGeom.PrimvarsAPI(mesh)
        primvar = api.CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex)
        primvar.Set(Vt.Vec2fArray.FromNumpy(np.sin(0.6 * points[:, :2]).astype(np.float32)))

    source = edited_scene(tmp_path / "textured.usda", stretch)
    counts = []
    for weight in (None, 0.0, 0.1):
        options = SimplifyOptions(faces=1500, metric="face", uv_weight=weight, frames=FrameRange(1, 25, 24))
        simplify_stage(source, tmp_path / f"out{len(counts)}.usda", options)
        _stage, mesh = read_mesh(tmp_path / f"out{len(counts)}.usda")
        counts.append(np.array(mesh.GetFaceVertexIndicesAttr().Get()))
    np.testing.assert_array_equal(counts[0], counts[2])
    assert not np.array_equal(counts[0], counts[1])


def test_lips_that_welding_would_join_are_found_on_the_points_as_authored(tmp_path: Path) -> None:
    output = tmp_path / "level.usda"
    run("simplify", str(SCENE), "-o", str(output), "--faces", "2000", "--frames", "1:1", "--bake")
    face = read_face(SCENE, FaceOptions(frames=FrameRange(1, 1)))
    named = named_points(output)
    for name in ("mouth_corner_left", "mouth_corner_right", "lip_contact"):
        np.testing.assert_allclose(named[name], face.points[0, face.features.vertices[name]], atol=1e-4)
