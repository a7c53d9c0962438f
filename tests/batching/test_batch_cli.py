"""`warpqem batch`."""

from __future__ import annotations

import io
import json
import re
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import pytest
from pxr import Sdf, UsdGeom
from rich.console import Console

from tests.support.cli import run
from tests.support.usd_stages import cloth_stage
from warpqem.batching.job_result import BatchResult
from warpqem.batching.jobs import BatchJob
from warpqem.cli.batch import _line
from warpqem.cli.batch_display import dry_run_table, summary_table
from warpqem.cli.batch_messages import result_lines
from warpqem.cli.tables import PlainTable
from warpqem.usd import SimplifyOptions
from warpqem.usd.write.stage_report import PrimReport


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
    assert f"error: {folder / 'in/bad.usda'}: there is no mesh on the stage" in result.stderr
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
        (["--ratio", "0.5", "--faces", "9"], "--ratio 0.5 and --faces 9 exclude each other"),
        ([], "one of --ratio"),
        (["--ratio", "0.5", "--jobs", "0"], "--jobs must be a whole number at least 1, got 0"),
        (["--ratio", "0.5", "--timeout", "-1"], "--timeout must be a finite number above 0, got -1"),
        (["--ratio", "0.5", "--retries", "-1"], "--retries must be a whole number at least 0, got -1"),
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
    assert f"error: manifest {folder / 'list.jsonl'}, line 2: no JSON" in result.stderr
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
    found = [
        {**asdict(PrimReport(f"/M{index}", "simplified", stopped="target")), **prim} for index, prim in enumerate(prims)
    ]
    report = {"input": "in.usd", "output": "out.usd", "prims": found, "problems": [], "notes": [], **more}
    return BatchResult("in.usd", "out.usd", "done", report=report)


def test_meshes_that_lost_the_same_share_a_line():
    result = report_of([{"dropped": ["skin", "creaseIndices"]}, {"dropped": ["heat"]}, {"dropped": ["heat"]}])
    assert result_lines(result) == [
        ("warning", "in.usd: /M0: dropped, does not fit the new mesh: skin, creaseIndices"),
        ("warning", "in.usd: 2 meshes: dropped, does not fit the new mesh: heat"),
    ]
    assert result_lines(result, each=True)[1:] == [
        ("warning", "in.usd: /M1: dropped, does not fit the new mesh: heat"),
        ("warning", "in.usd: /M2: dropped, does not fit the new mesh: heat"),
    ]


def test_level_that_lost_something_is_named():
    [(_, text)] = result_lines(report_of([{"dropped": ["heat"], "level": "LOD2"}]))
    assert text == "in.usd: LOD2: /M0: dropped, does not fit the new mesh: heat"


def test_problems_and_notes_of_meshes_are_told_once_for_those_that_have_them():
    prims = [
        {"problems": [f"/M{index}: a normal is no number"], "notes": [f"/M{index}: done run by run"]}
        for index in (0, 1)
    ]
    assert result_lines(report_of(prims, problems=["a file is missing"], notes=["come from the class /C"])) == [
        ("warning", "in.usd: a file is missing"),
        ("note", "in.usd: come from the class /C"),
        ("warning", "in.usd: 2 meshes: a normal is no number"),
        ("note", "in.usd: 2 meshes: done run by run"),
    ]


def test_notes_of_one_asset_end_somewhere_but_its_losses_and_errors_do_not():
    prims = [{"notes": [f"note {chr(65 + index)}"], "dropped": [f"value {chr(65 + index)}"]} for index in range(57)]
    prims += [{"status": "failed", "message": f"/M{index}: broken"} for index in range(57, 60)]
    lines = result_lines(report_of(prims))
    assert sum("dropped" in text for _, text in lines) == 57
    assert sum(kind == "error" for kind, _ in lines) == 3
    assert lines[-1] == ("note", "in.usd: and 37 more notes, see --json")


def test_errors_of_warpqem_need_no_name_and_others_have_one():
    known = BatchResult("in.usd", "out.usd", "failed", error="StageError", message="in.usd: damaged")
    assert result_lines(known) == [("error", "in.usd: damaged")]
    other = BatchResult("in.usd", "out.usd", "failed", error="KeyError", message="in.usd: 3")
    assert result_lines(other) == [("error", "KeyError: in.usd: 3")]


def table_text(table: PlainTable) -> str:
    console = Console(file=io.StringIO(), width=200)
    console.print(table.rendered())
    return console.file.getvalue()


def test_closing_table_has_the_reasons_of_failures_and_a_total_with_what_was_skipped():
    results = [
        BatchResult("a.usd", "out/a.usd", "done", faces=1000, faces_after=200, face_frames=10_000, seconds=2.0),
        BatchResult("b.usd", "out/b.usd", "skipped", faces=3000, faces_after=600, face_frames=30_000),
        BatchResult("c.usd", "out/c.usd", "failed", error="StageError", message="c.usd: there is no mesh on the stage"),
    ]
    text = table_text(summary_table(results, 3, 2.5))
    rows = {line.split()[0]: line.split()[1:4] for line in text.splitlines() if line.strip()}
    assert rows["skipped"] == ["1", "3,000", "600"]
    assert rows["total"] == ["3", "4,000", "800"]
    assert "failed: c.usd: there is no mesh on the stage" in text


def test_counts_of_what_was_skipped_are_those_of_when_it_was_done(folder):
    options = ("--ratio", 0.5, "--device", "cpu", "--jobs", 1)
    first = run("batch", folder / "in/deep/good.usda", "-o", folder / "out", *options)
    again = run("batch", folder / "in/deep/good.usda", "-o", folder / "out", *options, "--resume")
    done, skipped = (
        [line for line in each.stdout.splitlines() if name in line]
        for each, name in ((first, "done"), (again, "skipped"))
    )
    assert done[0].split()[1:5] == skipped[0].split()[1:5]
    assert int(done[0].split()[2]) > 0
    # A journal of an earlier version has no counts.
    journal = folder / "out" / ".warpqem-batch.jsonl"
    record = json.loads(journal.read_text())
    del record["counts"]
    journal.write_text(json.dumps(record) + "\n")
    assert " 0 " in run("batch", folder / "in/deep/good.usda", "-o", folder / "out", *options, "--resume").stdout


def test_dry_run_is_a_table_with_heads_size_goal_and_state(folder):
    missing = folder / "in" / "gone.usda"
    done = run("batch", folder / "in", missing, "-o", folder / "out", "--lods", "0.5,0.25", "--dry-run")
    text = done.stdout
    head = next(line for line in text.splitlines() if "input" in line)
    assert head.split() == ["input", "output", "size", "goal", "state"]
    assert re.search(r"bad\.usda +\S+bad\.usda +10 bytes lods 0\.5,0\.25 to do", text)
    assert re.search(r"gone\.usda +\S+gone\.usda +lods 0\.5,0\.25 no such file", text)


@pytest.mark.parametrize("width", [80, 100])
def test_dry_run_fits_a_terminal_with_paths_cut_on_the_left(width, tmp_path):
    job = BatchJob(f"/{'long/' * 20}body.usd", f"/{'other/' * 20}body.usd", SimplifyOptions(ratio=0.5))
    console = Console(file=io.StringIO(), width=width)
    console.print(dry_run_table([job], None).rendered(width))
    lines = console.file.getvalue().splitlines()
    assert max(map(len, lines)) <= width
    [row] = [line for line in lines if "body.usd" in line]
    assert re.fullmatch(r"\.\.\.\S*/body\.usd +\.\.\.\S*/body\.usd +ratio 0\.5 no such file *", row)


def test_last_line_says_what_was_written_and_quiet_prints_errors_alone(folder):
    options = ("--ratio", 0.5, "--device", "cpu", "--jobs", 1)
    done = run("batch", folder / "in", "-o", folder / "out", *options, "--json", folder / "lines.jsonl")
    assert re.fullmatch(
        rf"wrote 1 file in {folder / 'out'}, [\d.]+ KB; JSON {folder / 'lines.jsonl'}", done.stderr.splitlines()[-1]
    )
    quiet = run("batch", folder / "in", "-o", folder / "out", *options, "-q")
    assert (quiet.exit_code, quiet.stdout) == (1, "")
    assert quiet.stderr == f"error: {folder / 'in/bad.usda'}: there is no mesh on the stage\n"


def test_nothing_of_warp_is_printed_by_a_batch(folder):
    command = [sys.executable, "-m", "warpqem", "batch", str(folder / "in"), "-o", str(folder / "out")]
    command += ["--ratio", "0.5", "--jobs", "1"]
    for more in ([], ["--resume"], ["--resume", "--dry-run"]):
        done = subprocess.run([*command, *more], capture_output=True, text=True, check=False)
        assert not re.search("Warp|CUDA|Module|Kernel", done.stdout + done.stderr)


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
    said = [line.split(": ", 1) for line in alone.stderr.splitlines() if not line.startswith("wrote")]
    assert any("creaseIndices" in text and "primvars:heat (vertex)" in text for _, text in said)
    for kind, text in said:
        assert f"{kind}: {folder / 'in' / 'lossy.usda'}: {text}" in batch.stderr
    assert "1 of 1 assets lost what does not fit the new meshes" in " ".join(batch.stdout.split())
