"""No command and no function writes over a file that it reads: every option that names an output, every function."""

from __future__ import annotations

import inspect
import json
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, get_args

import pytest
import typer
from typer.testing import CliRunner, Result

import warpqem
from tests.support.commands import command_functions
from tests.support.shots import cloth_text, file_bytes, write_shot
from warpqem.cli.main import app
from warpqem.errors import OptionError
from warpqem.files.outputs import OutputFile
from warpqem.usd import CompareOptions, SimplifyOptions, color_features, compare_stages, inspect_stage, simplify_stage
from warpqem.usd.commands.face import draw_face, read_face, retarget_file
from warpqem.usd.commands.overview import write_overview
from warpqem.usd.commands.progressive import BuildOptions, LevelChoice, build_file, extract_level
from warpqem.usd.commands.render import RenderOptions, render_sheet
from warpqem.usd.commands.report_page import write_compare_report, write_simplify_report
from warpqem.usd.write.stage_report import PrimReport, StageReport

HEAD = Path(__file__).parents[2] / "scenes" / "talking_head.usdc"
HALF = SimplifyOptions(ratio=0.5, device="cpu")

# Options that take text and name no file that is written. Any other is taken for an output here: a new one that names
# an output needs no change, and one that does not is added.
NO_OUTPUTS = {
    "--address", "--asset-root", "--attribute-weight", "--device", "--face-points", "--frames", "--lods",
    "--memory", "--points", "--poses", "--prim", "--reference", "--size", "--source-points",
    "--source-prim", "--symmetry", "--target-points", "--target-prim", "--weight-primvar", "--faces", "--max-distance",
    "--variant", "--influences", "--joints", "--shapes", "--cache", "--arch",
}  # fmt: skip
# Numbers, which are text until they are checked.
UNITS = {"SHARE", "PCT", "FRAMES", "PX", "UNITS", "DEG", "WEIGHT", "EDGES", "FACES"}
# Arguments of each command beside its output, which comes last.
COMMANDS = {
    "simplify": "in.usda --ratio 0.5 --device cpu -o new.usda",
    "batch": "in.usda --ratio 0.5 --jobs 1 --device cpu -o new",
    "info": "in.usda",
    "compare": "in.usda in.usda --samples 50 --device cpu",
    "features": "in.usda --device cpu -o new.usda",
    "render": "in.usda --pictures 1 --device cpu -o new.png",
    "progressive build": "in.usda --device cpu -o new.wpqm",
    "progressive extract": "mesh.wpqm --ratio 0.5 -o new.usda",
    "progressive info": "mesh.wpqm",
    "face detect": "in.usda --frames 1:1 --device cpu",
    "face simplify": "in.usda --ratio 0.5 --device cpu -o new.usda",
    "face retarget": "in.usda in.usda --frames 1:1 --device cpu -o new.usda",
}
SUFFIXES = {"PNG": ".png", "--report": ".html"}


def output_options() -> Iterator[tuple[str, str, str]]:
    """Command, option and suffix of the file of every option that may name an output."""
    for command, function in command_functions():
        for name, parameter in inspect.signature(function, eval_str=True).parameters.items():
            kind, info = get_args(parameter.annotation)[:2]
            takes_text = {str, list[str], Path} & {kind, *get_args(kind)}
            if not isinstance(info, typer.models.OptionInfo) or not takes_text or info.metavar in UNITS:
                continue
            declared = [text for text in info.param_decls or () if text.startswith("--")]
            option = declared[0] if declared else "--" + name.replace("_", "-")
            if option not in NO_OUTPUTS and (command, option) != ("batch", "--output"):
                yield command, option, SUFFIXES.get(option) or SUFFIXES.get(info.metavar or "", ".usd")


def run(line: list[str]) -> Result:
    return CliRunner().invoke(app, line)


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    """A progressive mesh of the cloth."""
    folder = tmp_path_factory.mktemp("built")
    (folder / "in.usda").write_text(cloth_text())
    build_file(folder / "in.usda", folder / "mesh.wpqm", BuildOptions(device="cpu"))
    return folder / "mesh.wpqm"


@pytest.fixture
def folder(tmp_path, monkeypatch, built) -> Path:
    """The current folder: in.usda over geo.usd, and mesh.wpqm."""
    monkeypatch.chdir(tmp_path)
    write_shot(tmp_path)
    shutil.copy(built, tmp_path)
    return tmp_path


@pytest.fixture
def face_folder(tmp_path, monkeypatch) -> Path:
    """The same with a face."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(HEAD, tmp_path / "geo.usd")
    (tmp_path / "in.usda").write_text("#usda 1.0\n(\n    subLayers = [@./geo.usd@]\n)\n")
    return tmp_path


def option_cases() -> Iterator[Any]:
    for command, option, suffix in output_options():
        names = ["mesh.wpqm"] if command in ("progressive extract", "progressive info") else ["geo.usd", "in.usda"]
        # To find a face takes seconds.
        for name in names[:1] if command in ("face detect", "face retarget") else names:
            yield pytest.param(command, option, suffix, name, id=f"{command} {option} {name}")


@pytest.mark.parametrize(("command", "option", "suffix", "name"), [*option_cases()])
def test_no_option_writes_over_a_file_that_is_read(request, command, option, suffix, name):
    where: Path = request.getfixturevalue("face_folder" if command.startswith("face ") else "folder")
    file = name
    if not Path(name).suffix.startswith(suffix):
        # By the suffix alone it would be refused.
        file = f"link{suffix}"
        os.link(name, file)
    before = file_bytes(where)
    line = [*command.split(), *COMMANDS[command].split()]
    if option == "--output" and "-o" in line:
        line = line[: line.index("-o")]
    result = run([*line, option, file])
    assert result.exit_code == 2, result.output
    assert f"error: {option} {file}: this is " in result.stderr
    assert file_bytes(where) == before


def test_all_commands_have_their_outputs_looked_at():
    assert {command for command, _, _ in output_options()} == set(COMMANDS)


@pytest.mark.parametrize(
    ("command", "options"),
    [
        ("simplify", "--json new.usda"),
        ("simplify", "--report new.html --json new.html"),
        ("simplify", "--report new.html --json ./new.html"),
        ("compare", "--heatmap new.usda --json new.usda"),
        ("features", "--json new.usda"),
        ("progressive build", "--json new.wpqm"),
        ("progressive extract", "--json new.usda"),
        ("batch", "--json new.jsonl --log-json new.jsonl"),
        ("batch", "--json new/in.usda"),
        ("batch", "--log-json new/.warpqem-batch.jsonl"),
    ],
)
def test_no_command_writes_a_file_twice(folder, command, options):
    before = file_bytes(folder)
    result = run([*command.split(), *COMMANDS[command].split(), *options.split()])
    assert result.exit_code == 2, result.output
    assert "is the same file, and only one can be written" in result.stderr
    assert file_bytes(folder) == before


@pytest.mark.parametrize("option", ["--json", "-o"])
@pytest.mark.parametrize("name", ["poses.usda", "bones.usda"])
def test_poses_and_their_layers_are_kept(folder, option, name):
    (folder / "bones.usda").write_text(cloth_text())
    (folder / "poses.usda").write_text("#usda 1.0\n(\n    subLayers = [@./bones.usda@]\n)\n")
    before = file_bytes(folder)
    result = run([*f"simplify {COMMANDS['simplify']} --poses poses.usda".split(), option, name])
    assert result.exit_code == 2, result.output
    assert file_bytes(folder) == before


@pytest.mark.parametrize("command", ["simplify", "batch"])
def test_face_points_are_kept(folder, command):
    (folder / "points.json").write_text("{}")
    before = file_bytes(folder)
    result = run([*f"{command} {COMMANDS[command]} --metric face --face-points points.json --json points.json".split()])
    assert result.exit_code == 2, result.output
    assert "this is the file of points" in result.output or "this is a file of points" in result.output
    assert file_bytes(folder) == before


def test_reference_of_a_picture_is_kept(folder):
    (folder / "before.usda").write_text(cloth_text())
    os.link("before.usda", "before.png")
    result = run([*f"render {COMMANDS['render']} --reference before.usda".split(), "-o", "before.png"])
    assert result.exit_code == 2
    assert (folder / "before.png").read_text() == cloth_text()


@pytest.mark.parametrize("option", ["--output", "--picture", "--json"])
def test_points_of_a_face_are_kept(face_folder, option):
    (face_folder / "points.json").write_text("{}")
    os.link("points.json", "points.png")
    result = run([*f"face detect {COMMANDS['face detect']} --points points.json".split(), option, "points.png"])
    assert result.exit_code == 2, result.output
    assert f"{option} points.png: this is the file of points" in result.stderr
    assert (face_folder / "points.json").read_text() == "{}"


def test_older_outputs_are_replaced(folder):
    for command, names in {
        "simplify": ["new.usda", "--json", "new.json", "--report", "new.html"],
        "features": ["new.usda", "--json", "new.json"],
        "progressive build": ["new.wpqm"],
        "render": ["new.png"],
    }.items():
        line = [*command.split(), *COMMANDS[command].split(), *names[1:]]
        for time in range(2):
            for name in names:
                if time == 0 and not name.startswith("--"):
                    (folder / name).write_text("older")
            result = run(line)
            assert result.exit_code == 0, result.output
        assert not any(path.read_bytes() == b"older" for path in folder.iterdir() if path.name in names)


def test_report_may_go_to_standard_output(folder):
    result = run([*f"simplify {COMMANDS['simplify']} --json -".split()])
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["prims"]


FUNCTIONS: dict[str, tuple[str, Callable[[str], Any]]] = {
    "simplify_stage": (".usda", lambda name: simplify_stage("in.usda", name, HALF)),
    "levels": (".usda", lambda name: simplify_stage("in.usda", name, SimplifyOptions(lods=(0.5,)))),
    "simplify_stage beside": (
        ".usda", lambda name: simplify_stage("in.usda", "new.usda", HALF, other_outputs=[OutputFile("list", name)])
    ),
    "color_features": (".usda", lambda name: color_features("in.usda", name)),
    "compare_stages": (".usda", lambda name: compare_stages("in.usda", "in.usda", CompareOptions(heatmap=name))),
    "inspect_stage": (".usda", lambda name: inspect_stage("in.usda", [OutputFile("list", name)])),
    "build_file": (".usda", lambda name: build_file("in.usda", name, BuildOptions())),
    "render_sheet": (".png", lambda name: render_sheet("in.usda", name, RenderOptions())),
    "write_simplify_report": (
        ".html",
        lambda name: write_simplify_report(
            name, StageReport("in.usda", "in.usda", [PrimReport("/Root/Cloth", "simplified")]), HALF
        ),
    ),
    "write_compare_report": (
        ".html", lambda name: write_compare_report(name, "in.usda", "in.usda", [], CompareOptions())
    ),
    "batch": (".usda", lambda name: warpqem.batch([warpqem.BatchJob("in.usda", name, HALF)])),
}  # fmt: skip


@pytest.mark.parametrize("name", ["geo.usd", "in.usda", "other.usda"])
@pytest.mark.parametrize("function", FUNCTIONS)
def test_no_function_writes_over_a_file_that_is_read(folder, function, name):
    suffix, call = FUNCTIONS[function]
    file = name if suffix == ".usda" else f"link{suffix}"
    if file != name:
        os.link(name, file)
    before = file_bytes(folder)
    with pytest.raises(OptionError, match="which is never overwritten"):
        call(file)
    assert file_bytes(folder) == before


def test_faces_are_not_written_over_what_they_were_read_from(face_folder):
    os.link("geo.usd", "geo.png")
    face = read_face("in.usda")
    before = file_bytes(face_folder)
    for call in (lambda: draw_face(face, "geo.png"), lambda: retarget_file(face, face, "geo.usd")):
        with pytest.raises(OptionError, match="a sublayer of"):
            call()
    assert file_bytes(face_folder) == before


def test_level_is_not_written_over_its_progressive_mesh(folder):
    os.link("mesh.wpqm", "mesh.usda")
    before = file_bytes(folder)
    with pytest.raises(OptionError, match="this is the input"):
        extract_level("mesh.wpqm", "mesh.usda", LevelChoice(ratio=0.5))
    assert file_bytes(folder) == before


def test_progressive_mesh_is_not_saved_over_the_file_it_was_loaded_from(folder):
    from warpqem.progressive import load, save

    mesh = load("mesh.wpqm")
    os.link("mesh.wpqm", "link.wpqm")
    for name in ("mesh.wpqm", "link.wpqm"):
        with pytest.raises(OptionError, match="the file that the mesh was loaded from"):
            save(mesh, name)
    save(mesh, "copy.wpqm")
    save(mesh, "copy.wpqm")
    assert load("copy.wpqm").face_count == mesh.face_count


@pytest.mark.parametrize("name", ["in.usda", "out.usda", "needed.usda"])
def test_overview_is_not_written_over_an_asset(folder, name):
    for file in ("out.usda", "needed.usda"):
        (folder / file).write_text("#usda 1.0\n")
    os.link(name, "page.html")
    result = warpqem.BatchResult("in.usda", "out.usda", "failed", fingerprint={"files": {"needed.usda": None}})
    before = file_bytes(folder)
    with pytest.raises(OptionError, match="never overwritten"):
        write_overview("page.html", [result.to_dict()])
    assert file_bytes(folder) == before


@pytest.mark.parametrize("writer", ["picture", "page"])
def test_no_temporary_file_takes_the_place_of_another(folder, writer):
    import numpy as np

    from warpqem.picture import write_png
    from warpqem.report.page import save_page

    (folder / f".new.{os.getpid()}").write_text("kept")
    if writer == "picture":
        write_png(np.zeros((2, 2, 3), dtype=np.uint8), "new")
    else:
        save_page("new", "text")
    assert (folder / f".new.{os.getpid()}").read_text() == "kept"
