"""`warpqem batch`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from pxr import Sdf, UsdGeom

from tests.support.cli import run
from tests.support.usd_stages import cloth_stage
from warpqem.batching.job_result import BatchResult
from warpqem.cli.batch import _line
from warpqem.cli.batch_losses import loss_lines


@pytest.fixture
def folder(tmp_path) -> Path:
    (tmp_path / "in" / "deep").mkdir(parents=True)
    cloth_stage(tmp_path / "in" / "deep" / "good.usda")
    (tmp_path / "in" / "bad.usda").write_text("#usda 1.0\n")
    return tmp_path


def test_batch_writes_outputs_lines_a_log_and_a_table(folder):
    options = ("--ratio", 0.5, "--device", "cpu", "--jobs", 1, "--format", "usdc")
    files = ("--json", folder / "lines.jsonl", "--log-json", folder / "log.jsonl")
    result = run("batch", folder / "in", "-o", folder / "out", *options, *files)
    assert result.exit_code == 1
    assert sorted(path.relative_to(folder / "out").as_posix() for path in (folder / "out").rglob("*.*")) == [
        ".warpqem-batch.jsonl",
        "deep/good.usdc",
    ]
    lines = {Path(line["input"]).name: line for line in map(json.loads, (folder / "lines.jsonl").open())}
    assert (lines["good.usda"]["status"], lines["bad.usda"]["status"]) == ("done", "failed")
    assert f"error: StageError: {folder / 'in/bad.usda'}: there is no mesh on the stage" in result.stderr
    assert "2 of 2 assets" in result.stdout
    assert {json.loads(line)["level"] for line in (folder / "log.jsonl").open()} >= {"INFO", "DEBUG"}
    dry = run("batch", folder / "in", "-o", folder / "out", *options, "--resume", "--dry-run")
    assert dry.exit_code == 0
    assert "1 of 2 assets to be done" in dry.stdout


def test_dry_run_writes_nothing(folder):
    result = run("batch", folder / "in", "-o", folder / "out", "--ratio", 0.5, "--dry-run")
    assert result.exit_code == 0
    assert str(folder / "out/deep/good.usda") in result.stdout
    assert not (folder / "out").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--ratio", "0.5", "--faces", "9"], "ratio 0.5 and faces 9 exclude each other"),
        ([], "one of ratio"),
        (["--ratio", "0.5", "--jobs", "0"], "jobs 0"),
        (["--ratio", "0.5", "--timeout", "-1"], "timeout -1"),
        (["--ratio", "0.5", "--retries", "-1"], "retries -1"),
        (["--ratio", "0.5", "--memory", "much"], "memory 'much'"),
        (["--ratio", "0.5", "--gpus", "0.5"], "need --engine ray"),
        (["--ratio", "0.5", "--format", "obj"], "--format"),
    ],
)
def test_wrong_usage_is_one_line_and_exit_code_2(folder, options, message):
    result = run("batch", folder / "in", "-o", folder / "out", *options)
    assert result.exit_code == 2
    [line] = result.stderr.splitlines()
    assert line.startswith("error: ")
    assert message in line


def test_report_that_json_cannot_hold_does_not_cost_the_line():
    result = BatchResult("in.usda", "out.usda", "done", report={"error": float("nan")})
    assert json.loads(_line(result))["status"] == "done"


def test_unknown_device_is_an_error(folder):
    result = run("batch", folder / "in", "-o", folder / "out", "--ratio", 0.5, "--device", "tpu")
    assert result.exit_code == 1
    assert "no Warp device 'tpu'" in result.stderr


def test_wrong_lines_of_a_manifest_fail_and_the_others_are_done(folder):
    rows = ['{"input": "in/deep/good.usda"}', "nonsense", '{"input": "in/bad.usda", "rotio": 1}']
    (folder / "list.jsonl").write_text("\n".join(rows))
    options = ("--ratio", 0.5, "--device", "cpu", "--jobs", 1, "--json", folder / "lines.jsonl")
    result = run("batch", folder / "list.jsonl", "-o", folder / "out", *options, "--report", folder / "page.html")
    assert result.exit_code == 1
    assert f"error: OptionError: manifest {folder / 'list.jsonl'}, line 2: no JSON" in result.stderr
    assert "3 of 3 assets" in result.stdout
    lines = [json.loads(line) for line in (folder / "lines.jsonl").open()]
    assert [(line["status"], line["error"]) for line in lines] == [
        ("failed", "OptionError"),
        ("failed", "OptionError"),
        ("done", None),
    ]
    assert "line 3: there is no option 'rotio'" in lines[1]["message"]
    assert "1 of 3 assets are done" in (folder / "page.html").read_text()


@pytest.mark.parametrize(
    ("rows", "options", "code"),
    [
        (["nonsense", '{"input": "in/deep/good.usda"}'], ["--ratio", "0.5", "--strict"], 2),
        (["nonsense", '{"input": "in/deep/good.usda"}'], ["--ratio", "0.5", "--dry-run"], 1),
        (['{"input": "in/deep/good.usda"}'] * 2, [], 2),
        (["nonsense"], ["--ratio", "0.5"], 1),
    ],
)
def test_manifest_is_refused_as_a_whole_where_it_is_to_be(folder, rows, options, code):
    (folder / "list.jsonl").write_text("\n".join(rows))
    result = run("batch", folder / "list.jsonl", "-o", folder / "out", *options)
    assert result.exit_code == code
    assert "line 1: " in result.stderr


def report_of(prims: list[dict[str, object]], **more: object) -> BatchResult:
    """A result with so many meshes, of which each lost something or has notes."""
    plain = {"dropped": [], "problems": [], "notes": [], "symmetry": None, "status": "simplified", "stopped": "target"}
    found = [{**plain, "path": f"/M{index}", **prim} for index, prim in enumerate(prims)]
    return BatchResult("in.usd", "out.usd", "done", report={"prims": found, "problems": [], "notes": [], **more})


def test_meshes_that_lost_the_same_share_a_line():
    result = report_of([{"dropped": ["skin", "creaseIndices"]}, {"dropped": ["heat"]}, {"dropped": ["skin", "heat"]}])
    assert loss_lines(result) == [
        ("warning", "in.usd: /M0 and 1 more: dropped, does not fit the new mesh: skin"),
        ("warning", "in.usd: /M0: dropped, does not fit the new mesh: creaseIndices"),
        ("warning", "in.usd: /M1 and 1 more: dropped, does not fit the new mesh: heat"),
    ]


def test_level_that_lost_something_is_named():
    [(_, text)] = loss_lines(report_of([{"dropped": ["heat"], "level": "LOD2"}]))
    assert text == "in.usd: /M0 (LOD2): dropped, does not fit the new mesh: heat"


def test_problems_and_notes_of_meshes_are_told_once_for_those_that_have_them():
    prims = [
        {"problems": [f"/M{index}: a normal is no number"], "notes": [f"/M{index}: done run by run"]}
        for index in (0, 1)
    ]
    assert loss_lines(report_of(prims, problems=["a file is missing"], notes=["come from the class /C"])) == [
        ("warning", "in.usd: a file is missing"),
        ("warning", "in.usd: /M0 and 1 more: a normal is no number"),
        ("note", "in.usd: come from the class /C"),
        ("note", "in.usd: /M0 and 1 more: done run by run"),
    ]


def test_notes_of_one_asset_end_somewhere_but_its_losses_do_not():
    prims = [{"notes": [f"note {index}"], "dropped": [f"value {index}"]} for index in range(60)]
    lines = loss_lines(report_of(prims))
    assert sum("dropped" in text for _, text in lines) == 60
    assert lines[-1] == ("note", "in.usd: and 40 more notes, see --json")


def test_batch_tells_everything_that_simplify_tells(folder):
    stage = cloth_stage(folder / "in" / "lossy.usda")
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth"))
    mesh.CreateCreaseIndicesAttr([0, 1])
    mesh.CreateCreaseLengthsAttr([2])
    mesh.CreateCreaseSharpnessesAttr([1.0])
    UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("heat", Sdf.ValueTypeNames.FloatArray, "vertex").Set([1.0, 2.0])
    stage.Save()
    options = ("--ratio", 0.5, "--device", "cpu")
    alone = run("simplify", folder / "in" / "lossy.usda", "-o", folder / "alone.usda", *options)
    batch = run("batch", folder / "in" / "lossy.usda", "-o", folder / "out", *options, "--jobs", 1)
    told = [line for line in alone.stderr.splitlines() if "dropped, does not fit" in line]
    assert told
    for name in ("creaseIndices", "primvars:heat (vertex)"):
        assert name in told[0]
        assert name in batch.stderr
    assert "1 of 1 assets lost what does not fit the new meshes" in " ".join(batch.stdout.split())
