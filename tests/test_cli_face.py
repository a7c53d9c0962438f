"""The commands for faces."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pxr import Usd, UsdGeom, Vt
from typer.testing import CliRunner

from tests.faces import SCENE
from warpqem.cli.main import app
from warpqem.errors import OptionError
from warpqem.usd.face import FaceOptions, read_face


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
