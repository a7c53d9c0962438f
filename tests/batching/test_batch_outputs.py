"""A batch writes over no file that one of its jobs needs, and writes no file twice."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

import warpqem
from tests.support import batch_traps
from tests.support.shots import cloth_text, file_bytes, write_shot
from warpqem.batching.job_result import BatchResult
from warpqem.batching.output_check import check_batch_outputs
from warpqem.cli.main import app
from warpqem.errors import OptionError
from warpqem.files.outputs import OutputFile
from warpqem.usd import SimplifyOptions

HALF = SimplifyOptions(ratio=0.5, device="cpu")


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """The current folder: in.usda with all its files, and plain.usda, which needs none."""
    monkeypatch.chdir(tmp_path)
    write_shot(tmp_path)
    (tmp_path / "plain.usda").write_text(cloth_text())
    return tmp_path


def run(*arguments: str) -> Result:
    return CliRunner().invoke(app, ["batch", *arguments, "--jobs", "1", "--device", "cpu"])


def manifest(path: Path, *rows: dict[str, Any]) -> str:
    path.write_text("".join(json.dumps({"ratio": 0.5, **row}) + "\n" for row in rows))
    return str(path)


@pytest.mark.parametrize("dry", [[], ["--dry-run"]], ids=["", "dry"])
def test_output_of_one_job_is_no_layer_of_another(folder, dry):
    rows = {"input": "in.usda", "output": "new.usda"}, {"input": "plain.usda", "output": "other.usda"}
    jobs = manifest(folder / "jobs.jsonl", *rows)
    before = file_bytes(folder)
    result = run(jobs, "-o", str(folder), *dry)
    assert result.exit_code == 2, result.output
    said = f"output {folder}/other.usda: this is a reference of /Root/Props{{look=old}} in {folder}/in.usda"
    assert said in result.stderr
    assert file_bytes(folder) == before


@pytest.mark.parametrize("option", ["--json", "--log-json"])
def test_manifest_is_not_written_over(folder, option):
    jobs = manifest(folder / "jobs.jsonl", {"input": "plain.usda", "output": "new.usda"})
    before = file_bytes(folder)
    result = run(jobs, "-o", "out", option, "jobs.jsonl")
    assert result.exit_code == 2
    assert f"{option} jobs.jsonl: this is a manifest, which is never overwritten" in result.stderr
    assert file_bytes(folder) == before


def test_poses_of_a_line_are_not_written_over(folder):
    (folder / "poses.usda").write_text("#usda 1.0\n(\n    subLayers = [@./bones.usda@]\n)\n")
    (folder / "bones.usda").write_text(cloth_text())
    row = {"input": "plain.usda", "poses": "poses.usda"}
    for name in ("poses.usda", "bones.usda"):
        jobs = manifest(folder / "jobs.jsonl", {**row, "output": "new.usda"}, {"input": "in.usda", "output": name})
        before = file_bytes(folder)
        assert run(jobs, "-o", str(folder)).exit_code == 2
        assert file_bytes(folder) == before


def test_journal_that_leads_to_a_layer_is_refused(folder):
    (folder / "out").mkdir()
    (folder / "out" / ".warpqem-batch.jsonl").symlink_to("../geo.usd")
    before = file_bytes(folder)
    result = run("in.usda", "-o", "out", "--ratio", "0.5")
    assert result.exit_code == 2
    assert "this is a sublayer of" in result.stderr
    assert file_bytes(folder) == before


def test_outputs_that_are_one_file_by_links_are_refused(folder):
    (folder / "one.usda").write_text("older")
    os.link("one.usda", "two.usda")
    jobs = [warpqem.BatchJob("plain.usda", name, HALF) for name in ("one.usda", "two.usda")]
    with pytest.raises(OptionError, match="is the same file"):
        warpqem.batch(jobs)


def test_job_that_cannot_be_read_keeps_its_older_output_and_stops_no_other(folder):
    (folder / "bad.usda").write_text("no layer")
    (folder / "old_bad.usda").write_text("older")
    (folder / "old_good.usda").write_text("older")
    jobs = [warpqem.BatchJob(f"{name}.usda", f"old_{new}.usda", HALF) for name, new in (("bad", "bad"), ("in", "good"))]
    results = {result.input: result for result in warpqem.batch(jobs, warpqem_engine())}
    assert (results["in.usda"].status, results["bad.usda"].status) == ("done", "failed")
    assert results["bad.usda"].error == "StageError"
    assert "bad.usda" in (results["bad.usda"].message or "")
    assert (folder / "old_bad.usda").read_text() == "older"
    assert (folder / "old_good.usda").read_text() != "older"


def warpqem_engine() -> Any:
    from warpqem.batching.local_engine import LocalEngine

    return LocalEngine(workers=1, device="cpu")


class Sprung(str):
    """A folder that does something to the process that it is sent to."""

    def __new__(cls, trap: str, marker: Path) -> Sprung:
        made = super().__new__(cls, "/")
        made.trap, made.marker = trap, str(marker)
        return made

    trap: str
    marker: str

    def __reduce__(self) -> tuple[Any, ...]:
        return spring, (self.trap, self.marker)


def spring(trap: str, marker: str) -> str:
    batch_traps.TRAPS[trap](marker)
    return "/"


def look(folder: Path, trap: str) -> dict[str, BatchResult]:
    trapped = SimplifyOptions(ratio=0.5, asset_roots=(Sprung(trap, folder / "marker"),))
    (folder / "new.usda").write_text("older")
    jobs = [warpqem.BatchJob("plain.usda", "new.usda", trapped), warpqem.BatchJob("in.usda", "second.usda", HALF)]
    return check_batch_outputs(jobs)


def test_input_that_ends_the_process_has_failed_and_the_others_are_looked_at(folder):
    [(output, result)] = look(folder, "crash").items()
    assert (output, result.status, result.error) == ("new.usda", "failed", "WorkerLost")
    assert "SIGABRT" in (result.message or "")


def test_input_whose_process_was_stopped_from_outside_is_looked_at_again(folder):
    assert look(folder, "killed once") == {}
    assert (folder / "marker").exists()


def test_nothing_is_looked_for_where_no_output_is_there_yet(folder, monkeypatch):
    monkeypatch.setattr("warpqem.batching.output_check._find_problems", lambda *_: pytest.fail("looked"))
    assert check_batch_outputs([warpqem.BatchJob("in.usda", "new.usda", HALF)], [OutputFile("--json", "a.json")]) == {}


def test_script_that_its_processes_would_run_again_is_told_so(folder):
    (folder / "new.usda").write_text("older")
    script = "import warpqem\nfrom warpqem.usd import SimplifyOptions\n"
    script += 'warpqem.batch([warpqem.BatchJob("plain.usda", "new.usda", SimplifyOptions(ratio=0.5))])\n'
    (folder / "script.py").write_text(script)
    environment = {**os.environ, "PYTHONPATH": str(Path(warpqem.__file__).parent.parent)}
    command = [sys.executable, "script.py"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode != 0
    assert 'needs if __name__ == "__main__"' in done.stderr
