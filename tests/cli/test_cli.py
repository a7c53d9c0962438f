"""The command line."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from pxr import Usd, UsdGeom

import warpqem
from tests.support.cli import run
from tests.support.usd_stages import cloth_stage, define_cloth
from warpqem.batching.perform_job import perform
from warpqem.cli.main import app
from warpqem.errors import OptionError
from warpqem.usd import SimplifyOptions, simplify_stage


@pytest.fixture
def cloth(tmp_path) -> Path:
    cloth_stage(tmp_path / "in.usda")
    return tmp_path / "in.usda"


@pytest.fixture
def half_broken(tmp_path) -> Path:
    """A file with one good mesh and one that cannot be read."""
    stage = cloth_stage(tmp_path / "in.usda")
    define_cloth(stage, "/Root/Broken").GetFaceVertexCountsAttr().Set([4])
    stage.Save()
    return tmp_path / "in.usda"


def test_simplify_writes_the_output_and_a_table(cloth, tmp_path):
    result = run("simplify", cloth, "-o", tmp_path / "out.usda", "--ratio", 0.5, "--device", "cpu")
    assert result.exit_code == 0
    assert "/Root/Cloth" in result.stdout
    assert "128" in result.stdout
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    assert len(UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth")).GetFaceVertexCountsAttr().Get()) in (63, 64)


def test_simplify_passes_all_options_on(cloth, tmp_path):
    options = (
        "--max-error 2 --metric dod --coherence 0.2 --placement endpoint --key-frames 2 --frames 1:2 --uv-weight 1"
    )
    switches = "--flatten --bake --no-weld"
    report = tmp_path / "report.json"
    result = run(
        "simplify", cloth, "-o", tmp_path / "out.usdc", *options.split(), *switches.split(), "--prim", "/Root",
        "--device", "cpu", "--json", report,
    )  # fmt: skip
    assert result.exit_code == 0, result.stderr
    [prim] = json.loads(report.read_text())["prims"]
    assert (prim["frames"], prim["stopped"]) == (2, "max_error")


def test_a_limit_that_cannot_be_proved_has_one_answer(cloth, tmp_path):
    options = SimplifyOptions(max_error=1e-9, device="cpu")
    with pytest.raises(OptionError, match="max_error 1e-09 %") as refused:
        simplify_stage(cloth, tmp_path / "out.usda", options)
    result = run("simplify", cloth, "-o", tmp_path / "out.usda", "--max-error", 1e-9, "--device", "cpu")
    # On the command line by the name of the flag.
    said = str(refused.value).replace("max_error", "--max-error")
    assert (result.exit_code, result.stderr.splitlines()[-1]) == (2, f"error: {said}")
    done = perform(warpqem.BatchJob(str(cloth), str(tmp_path / "out.usda"), options))
    assert (done.status, done.error, done.message) == ("failed", "OptionError", f"{cloth}: {refused.value}")
    assert not (tmp_path / "out.usda").exists()


def test_simplify_names_what_it_drops(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth")).CreateHoleIndicesAttr([3])
    stage.Save()
    files = (tmp_path / "in.usda", "-o", tmp_path / "out.usda")
    result = run("simplify", *files, "--ratio", 0.5, "--device", "cpu")
    assert [line for line in result.stderr.splitlines() if line.startswith("warning: /Root/Cloth: dropped")] != []
    assert "holeIndices" in result.stderr


def test_json_to_stdout_is_all_there_is_on_stdout(cloth, tmp_path):
    result = run("simplify", cloth, "-o", tmp_path / "out.usda", "--ratio", 0.5, "--device", "cpu", "--json", "-")
    assert json.loads(result.stdout)["prims"][0]["status"] == "simplified"
    assert "/Root/Cloth" in result.stderr


def test_limit_of_infinity_stands_in_the_json_as_it_is_given(cloth, tmp_path):
    options = ("--ratio", 0.5, "--device", "cpu", "--max-size-error", "inf")
    result = run("simplify", cloth, "-o", tmp_path / "out.usda", *options, "--json", "-")
    assert result.exit_code == 0
    assert json.loads(result.stdout)["run"]["options"]["max_size_error"] == "inf"


def test_one_failed_mesh_gives_exit_code_1(half_broken, tmp_path):
    result = run("simplify", half_broken, "-o", tmp_path / "out.usda", "--ratio", 0.5, "--device", "cpu")
    assert result.exit_code == 1
    assert (tmp_path / "out.usda").exists()
    assert any(line.startswith("error: /Root/Broken.faceVertexCounts") for line in result.stderr.splitlines())


def test_strict_writes_nothing(half_broken, tmp_path):
    result = run("simplify", half_broken, "-o", tmp_path / "out.usda", "--ratio", 0.5, "--device", "cpu", "--strict")
    assert result.exit_code == 1
    assert not (tmp_path / "out.usda").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--ratio", "25"], "for 25 % give 0.25"),
        (["--ratio", "0"], "ratio must be in (0, 1], got 0"),
        (["--ratio", "0.5", "--faces", "9"], "--ratio 0.5 and --faces 9 exclude each other"),
        ([], "one of --ratio"),
        (["--ratio", "0.5", "--frames", "9:1"], "frame range"),
        (["--ratio", "0.5", "--metric", "best"], "--metric"),
        (["--ratio", "half"], "--ratio"),
        (["--rotio", "0.5"], "--rotio"),
        (["--ratio", "0.5", "--coherence", "7"], "coherence"),
        (["--ratio", "0.5", "--uv-weight", "-1"], "--uv-weight"),
        (["--ratio", "0.5", "--attribute-weight", "st"], "NAME=WEIGHT"),
        (["--ratio", "0.5", "--attribute-weight", "st=1"], "primvar st"),
    ],
)
def test_wrong_usage_is_one_line_and_exit_code_2(cloth, tmp_path, options, message):
    result = run("simplify", cloth, "-o", tmp_path / "out.usda", *options)
    assert result.exit_code == 2
    [line] = result.stderr.splitlines()
    assert line.startswith("error: ")
    assert message in line


def test_missing_input_is_one_line_and_exit_code_1(tmp_path):
    result = run("simplify", tmp_path / "none.usd", "-o", tmp_path / "out.usda", "--ratio", 0.5)
    assert result.exit_code == 1
    assert result.stderr.splitlines() == [f"error: {tmp_path / 'none.usd'}: no such file"]


def test_input_as_output_is_refused(cloth):
    before = cloth.read_bytes()
    result = run("simplify", cloth, "-o", cloth, "--ratio", 0.5)
    assert result.exit_code == 2
    assert cloth.read_bytes() == before


def test_device_that_does_not_exist_is_one_line(cloth, tmp_path):
    result = run("simplify", cloth, "-o", tmp_path / "out.usda", "--ratio", 0.5, "--device", "cuda:77")
    assert result.exit_code == 1
    assert "cuda:77" in result.stderr.splitlines()[-1]


def test_defect_is_one_line_without_a_traceback(cloth, tmp_path, monkeypatch):
    def fail(*arguments: object, **options: object) -> None:
        raise ZeroDivisionError("by nought")

    monkeypatch.setattr("warpqem.usd.commands.simplify.simplify_stage", fail)
    result = run("simplify", cloth, "-o", tmp_path / "out.usda", "--ratio", 0.5)
    assert result.exit_code == 1
    assert result.stderr.startswith("error: ZeroDivisionError: by nought")
    assert "Traceback" not in result.output


def test_info_describes_each_mesh(cloth):
    result = run("info", cloth)
    assert result.exit_code == 0
    assert "/Root/Cloth" in result.stdout


def test_info_as_json(half_broken):
    result = run("info", half_broken, "--json", "-")
    assert result.exit_code == 0
    meshes = json.loads(result.stdout)["meshes"]
    assert [mesh["triangles"] for mesh in meshes] == [128, 0]
    assert "faceVertexCounts" in meshes[1]["problems"][0]


def test_compare_measures_a_result_against_its_input(cloth, tmp_path):
    out, report = tmp_path / "out.usda", tmp_path / "report.json"
    run("simplify", cloth, "-o", out, "--ratio", 0.5, "--device", "cpu")
    heat = tmp_path / "heat.usdc"
    result = run("compare", cloth, out, "--samples", 200, "--json", report, "--heatmap", heat, "--device", "cpu")
    assert result.exit_code == 0, result.stderr
    [prim] = json.loads(report.read_text())["prims"]
    assert prim["comparison"]["rms"] > 0
    assert len(prim["comparison"]["per_frame"]["rms"]) == 3
    assert heat.exists()


def test_compare_of_meshes_without_faces_is_done(tmp_path):
    stage = Usd.Stage.CreateNew(str(tmp_path / "in.usda"))
    UsdGeom.Mesh.Define(stage, "/Empty").CreatePointsAttr([])
    for create in (UsdGeom.Mesh.CreateFaceVertexCountsAttr, UsdGeom.Mesh.CreateFaceVertexIndicesAttr):
        create(UsdGeom.Mesh(stage.GetPrimAtPath("/Empty")), [])
    stage.Save()
    run("simplify", tmp_path / "in.usda", "-o", tmp_path / "out.usda", "--ratio", 0.5, "--device", "cpu")
    result = run("compare", tmp_path / "in.usda", tmp_path / "out.usda", "--device", "cpu")
    assert result.exit_code == 0
    assert "no faces" in result.output


@pytest.mark.parametrize("number", ["1_0", "\u0663"])
def test_a_number_in_other_than_plain_digits_is_refused(cloth, tmp_path, number):
    result = run("compare", cloth, cloth, "--samples", number, "--device", "cpu")
    assert result.exit_code == 2
    assert f"must be a whole number at least 1, got '{number}'; give" in " ".join(result.output.split())


def test_compare_with_a_mesh_missing_gives_exit_code_1(cloth, tmp_path):
    stage = cloth_stage(tmp_path / "two.usda")
    define_cloth(stage, "/Root/Flag")
    stage.Save()
    result = run("compare", cloth, tmp_path / "two.usda", "--samples", 100, "--device", "cpu")
    assert result.exit_code == 1
    assert "error: /Root/Flag: no such mesh" in result.stderr


def test_features_writes_colors(cloth, tmp_path):
    result = run("features", cloth, "-o", tmp_path / "out.usda", "--device", "cpu")
    assert result.exit_code == 0, result.stderr
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    assert UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth")).GetDisplayColorPrimvar().HasAuthoredValue()


def test_version_is_printed():
    assert run("--version").stdout.startswith("warpqem ")


@pytest.mark.parametrize("command", ["simplify", "info", "compare", "features"])
def test_every_option_has_a_help_text(command):
    import typer.main

    group = typer.main.get_command(app)
    for parameter in group.commands[command].params:
        assert parameter.help, parameter.name


def test_help_loads_neither_warp_nor_usd():
    code = (
        "import sys; sys.argv = ['warpqem', '--help']\n"
        "from warpqem.cli.main import app\n"
        "try:\n    app()\nexcept SystemExit as stop:\n    assert stop.code == 0\n"
        "assert not {'warp', 'pxr', 'numpy', 'trimesh'} & set(sys.modules), sorted(sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def run_with_cache(cache, *arguments):
    """Run a command in its own process, with Warp's kernel cache in a directory."""
    command = [sys.executable, "-m", "warpqem", *map(str, arguments)]
    environment = {**os.environ, "WARP_CACHE_PATH": str(cache)}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    return done


def test_only_the_run_that_compiles_says_so(cloth, tmp_path):
    # The features need two small kernel modules only.
    arguments = ("features", cloth, "-o", tmp_path / "out.usda", "--device", "cpu", "--json", "-")
    first, second = (run_with_cache(tmp_path / "cache", *arguments) for _ in range(2))
    assert (first.stderr.count("note: compiling"), second.stderr.count("note: compiling")) == (1, 0)
    assert json.loads(first.stdout) == json.loads(second.stdout)


def test_reading_a_file_does_not_load_trimesh(cloth, tmp_path):
    code = (
        f"import sys; sys.argv = ['warpqem', 'simplify', {str(cloth)!r}, '-o', {str(tmp_path / 'out.usda')!r}, "
        "'--ratio', '0.5', '--device', 'cpu']\n"
        "from warpqem.cli.main import app\n"
        "try:\n    app()\nexcept SystemExit as stop:\n    assert stop.code == 0\n"
        "assert 'trimesh' not in sys.modules"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_brackets_in_a_file_name_are_no_markup(tmp_path):
    cloth_stage(tmp_path / "take[bold].usda")
    assert "take[bold].usda" in run("info", tmp_path / "take[bold].usda").stdout
