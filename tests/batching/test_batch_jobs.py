"""What a batch is made of: inputs, manifests, fingerprints, the journal."""

from __future__ import annotations

import json
import os
import threading
from pathlib import Path

import pytest
from pxr import Usd

from tests.support.usd_stages import cloth_stage
from warpqem.batching.engine import Finished, Progressed, Started
from warpqem.batching.fingerprint import is_current, take_fingerprint
from warpqem.batching.job_result import DONE, FAILED, BatchResult
from warpqem.batching.jobs import BatchJob, check_jobs, find_files, output_path
from warpqem.batching.journal import Journal
from warpqem.batching.manifest import read_lines, read_manifest
from warpqem.batching.run_batch import batch
from warpqem.errors import BatchError, CancelledError, OptionError
from warpqem.usd import SimplifyOptions

HALF = SimplifyOptions(ratio=0.5)


@pytest.fixture
def tree(tmp_path) -> Path:
    """Files by name only: nothing here reads them."""
    for name in ("a.usda", "b/c.usd", "b/d/e.usdz", "b/notes.txt", ".hidden.usda", "b/.cache/f.usd", "out/a.usda"):
        (tmp_path / "in" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "in" / name).write_text("")
    return tmp_path / "in"


def relatives(inputs, **options) -> list[str]:
    return [file.relative.as_posix() for file in find_files(inputs, **options)]


def test_folder_gives_the_usd_files_below_it_with_their_places(tree):
    assert relatives([tree], leave_out=tree / "out") == ["a.usda", "b/c.usd", "b/d/e.usdz"]


def test_pattern_gives_places_below_its_fixed_part(tree):
    assert relatives([f"{tree}/b/**/*.usd*"]) == ["c.usd", "d/e.usdz"]
    assert relatives([f"{tree}/*/c.usd"]) == ["b/c.usd"]


def test_file_that_is_named_keeps_its_name_only_and_comes_once(tree):
    assert relatives([tree / "b/c.usd", tree / "b"]) == ["c.usd", "d/e.usdz"]


def test_missing_file_is_left_to_fail_by_itself(tree):
    assert relatives([tree / "gone.usda", tree / "a.usda"]) == ["gone.usda", "a.usda"]


@pytest.mark.parametrize("name", ["gone", "*.obj", "b/.cache"])
def test_input_that_names_nothing_is_refused(tree, name):
    (tree / "b/.cache/f.usd").unlink()
    with pytest.raises(OptionError, match="no such file, and no folder"):
        find_files([tree / name])


@pytest.mark.parametrize(
    ("relative", "suffix", "expected"),
    [("a/b.usda", None, "a/b.usda"), ("a/b.usdz", None, "a/b.usdc"), ("a/b.v2.usd", ".usdc", "a/b.v2.usdc")],
)
def test_output_keeps_place_and_kind(tmp_path, relative, suffix, expected):
    assert output_path(tmp_path, Path(relative), suffix) == str(tmp_path / expected)


def test_two_jobs_with_one_output_are_refused(tmp_path):
    jobs = [BatchJob(f"/{name}/x.usd", str(tmp_path / "x.usd"), HALF) for name in "ab"]
    with pytest.raises(OptionError, match=r"both /a/x\.usd and /b/x\.usd"):
        check_jobs(jobs)


def test_output_that_is_an_input_of_another_job_is_refused(tree):
    jobs = [
        BatchJob(str(tree / "a.usda"), str(tree / "b/c.usd"), HALF),
        BatchJob(str(tree / "b/c.usd"), "/x.usd", HALF),
    ]
    with pytest.raises(OptionError, match="is an input, which is never overwritten"):
        check_jobs(jobs)


@pytest.mark.parametrize("kind", ["jsonl", "csv"])
def test_manifest_gives_each_asset_its_options(tree, kind):
    path = tree / f"list.{kind}"
    if kind == "csv":
        path.write_text("input,output,ratio,max-error,refit\na.usda,,0.25,,\nb/c.usd,x/y.usda,,2,true\n")
    else:
        rows = [{"input": "a.usda", "ratio": 0.25}, {"input": "b/c.usd", "output": "x/y.usda", "max-error": 2}]
        path.write_text("\n".join(json.dumps({**row, "refit": "max-error" in row}) for row in rows))
    jobs = read_manifest(path, tree / "out", {"ratio": 0.5, "key_frames": 4})
    # An empty cell of a table leaves it to the quality.
    refit = None if kind == "csv" else False
    assert jobs == [
        BatchJob(
            str(tree / "a.usda"), str(tree / "out/a.usda"), SimplifyOptions(ratio=0.25, key_frames=4, refit=refit)
        ),
        BatchJob(
            str(tree / "b/c.usd"),
            str(tree / "out/x/y.usda"),
            SimplifyOptions(max_error=2.0, key_frames=4, refit=True),
        ),
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"input": "a.usda", "rotio": 1}', "line 1: there is no option 'rotio'"),
        ('{"input": "a.usda"}\n{"input": 3}', "line 2: there is no input"),
        ("{", "line 1: no JSON"),
        ("[" * 100000, "line 1: no JSON"),
        ("[1]", "line 1: expected an object"),
        ('{"input": "a.usda", "output": "../a.usda"}', "outside of"),
        ('{"input": "a.usda", "ratio": 7}', "line 1: ratio must be in .* got 7"),
        ("\n", "names no asset"),
    ],
)
def test_wrong_manifest_is_refused_with_its_line(tree, text, message):
    (tree / "list.jsonl").write_text(text)
    with pytest.raises(OptionError, match=message):
        read_manifest(tree / "list.jsonl", tree / "out", {"ratio": 0.5})


def test_manifest_that_is_no_text_is_refused(tree):
    (tree / "list.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(OptionError, match="cannot be read"):
        read_manifest(tree / "list.csv", tree / "out", {})


def wrong_lines(path: Path, content: bytes) -> tuple[list[str], dict[int, str]]:
    """Names of the inputs of a manifest, and what is wrong with its other lines."""
    path.write_bytes(content)
    manifest = read_lines(path, path.parent / "out", {"ratio": 0.5})
    return [Path(job.input).name for job in manifest.jobs], {line.line: line.reason for line in manifest.wrong}


def test_wrong_lines_of_json_are_named_and_the_others_stay(tmp_path):
    lines = [
        b'{"input": "a.usda"}', b"{", b'{"input": "b\xff.usda"}', b"", b'{"input": "c.usda", "ratio": 1e999}',
        b'{"input": "\\u0000"}', b'{"input": "\\ud800"}', b'{"input": "d.usda", "faces": ' + b"9" * 5000 + b"}",
        b'{"input": "e.usda", "ratio": ' + b"9" * 400 + b"}", '{"input": "f\u2028\x85.usda"}'.encode(),
        b'{"input": "g.usda"}',
    ]  # fmt: skip
    inputs, wrong = wrong_lines(tmp_path / "list.jsonl", b"\xef\xbb\xbf" + b"\r\n".join(lines))
    assert inputs == ["a.usda", "f\u2028\x85.usda", "g.usda"]
    assert list(wrong) == [2, 3, 5, 6, 7, 8, 9]
    assert (wrong[3], wrong[6]) == (
        "bytes that are no UTF-8",
        "input '\\x00': no name of a file (it holds a zero byte)",
    )


def test_wrong_rows_of_csv_are_named_and_the_others_stay(tmp_path):
    rows = b'input,ratio\n a.usda,0.5\n"b.usda,0.5\nc.usda,"0.5"x\n\xff.usda,1\nd.usda,1,2\n\n,1\n"e\nf.usda",1\n'
    rows += b"g.usda,7\nh.usda\n"
    inputs, wrong = wrong_lines(tmp_path / "list.csv", rows)
    assert inputs == [" a.usda", "e\nf.usda", "h.usda"]
    assert list(wrong) == [3, 4, 5, 6, 8, 11]
    assert wrong[6] == "more values than the header has names"


def test_line_that_would_write_over_another_is_wrong(tmp_path):
    rows = [
        {"input": "a.usda"},
        {"input": "x/a.usda", "output": "a.usda"},
        {"input": "out/b.usda"},
        {"input": "b.usda"},
    ]
    inputs, wrong = wrong_lines(tmp_path / "list.jsonl", "\n".join(map(json.dumps, rows)).encode())
    assert inputs == ["a.usda", "b.usda"]
    assert wrong == {
        2: f"output {tmp_path / 'out/a.usda'}: line 1 writes it, too",
        4: f"output {tmp_path / 'out/b.usda'}: this is an input, which is never overwritten",
    }


@pytest.mark.skipif(os.name != "posix", reason="pipes in folders")
@pytest.mark.parametrize("name", ["pipe", "/proc/self/mem", "/dev/zero", "."])
def test_manifest_without_an_end_is_refused(tmp_path, name):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "list.csv").symlink_to(tmp_path / name)
    with pytest.raises(OptionError, match=r"list\.csv: no regular file, but"):
        read_lines(tmp_path / "list.csv", tmp_path, {"ratio": 0.5})


@pytest.fixture
def layered(tmp_path) -> BatchJob:
    """An input with a layer below it, a reference to a file that is missing, and an output."""
    cloth_stage(tmp_path / "geo.usda")
    stage = Usd.Stage.CreateNew(str(tmp_path / "in.usda"))
    stage.GetRootLayer().subLayerPaths.append("./geo.usda")
    stage.OverridePrim("/Root/Other").GetReferences().AddReference("./later.usda")
    stage.Save()
    (tmp_path / "out.usda").write_text("output")
    return BatchJob(str(tmp_path / "in.usda"), str(tmp_path / "out.usda"), HALF)


def record(job: BatchJob, tmp_path: Path) -> dict:
    with Journal(tmp_path / "journal") as journal:
        journal.add(BatchResult(job.input, job.output, DONE, fingerprint=take_fingerprint(job)))
    return json.loads((tmp_path / "journal").read_text())


def test_nothing_changed_is_current(layered, tmp_path):
    assert is_current(layered, record(layered, tmp_path))


@pytest.mark.parametrize("name", ["in.usda", "geo.usda", "later.usda", "out.usda"])
def test_any_file_that_changes_is_seen(layered, tmp_path, name):
    known = record(layered, tmp_path)
    with open(tmp_path / name, "a") as file:
        file.write("\n")
    assert not is_current(layered, known)


def test_output_that_is_gone_is_seen(layered, tmp_path):
    known = record(layered, tmp_path)
    Path(layered.output).unlink()
    assert not is_current(layered, known)


def test_other_options_and_another_version_are_seen(layered, tmp_path, monkeypatch):
    known = record(layered, tmp_path)
    for options in (SimplifyOptions(ratio=0.4), SimplifyOptions(ratio=0.5, refit=True)):
        assert not is_current(BatchJob(layered.input, layered.output, options), known)
    assert is_current(BatchJob(layered.input, layered.output, SimplifyOptions(ratio=0.5, memory="1G")), known)
    monkeypatch.setattr("warpqem.batching.fingerprint.warpqem.__version__", "99", raising=False)
    assert not is_current(layered, known)


def test_file_with_poses_counts(layered, tmp_path):
    (tmp_path / "poses.usda").write_text("#usda 1.0\n")
    job = BatchJob(layered.input, layered.output, SimplifyOptions(ratio=0.5, poses=str(tmp_path / "poses.usda")))
    known = record(job, tmp_path)
    assert is_current(job, known)
    (tmp_path / "poses.usda").write_text("#usda 1.0\n\n")
    assert not is_current(job, known)


def test_file_with_feature_points_counts(layered, tmp_path):
    (tmp_path / "points.json").write_text("{}")
    options = SimplifyOptions(ratio=0.5, metric="face", face_points=str(tmp_path / "points.json"))
    job = BatchJob(layered.input, layered.output, options)
    known = record(job, tmp_path)
    assert is_current(job, known)
    (tmp_path / "points.json").write_text('{"chin": 3}')
    assert not is_current(job, known)


@pytest.mark.parametrize("text", ["", "x", '{"output": "out.usda"}', '{"output": "out.usda", "fingerprint": 3}', "[]"])
def test_damaged_journal_is_nothing_done(layered, tmp_path, text):
    (tmp_path / "journal").write_text(text)
    with Journal(tmp_path / "journal") as journal:
        assert not journal.is_done(layered)


def test_line_that_was_cut_short_costs_no_other(layered, tmp_path):
    record(layered, tmp_path)
    text = (tmp_path / "journal").read_text()
    (tmp_path / "journal").write_text(text + text[:40])
    with Journal(tmp_path / "journal") as journal:
        assert journal.is_done(layered)
        journal.add(BatchResult(layered.input, layered.output, DONE, fingerprint=take_fingerprint(layered)))
    assert [line for line in (tmp_path / "journal").read_text().splitlines() if line == text.strip()] != []


def test_what_failed_is_not_noted(layered, tmp_path):
    with Journal(tmp_path / "journal") as journal:
        journal.add(BatchResult(layered.input, layered.output, FAILED, fingerprint=take_fingerprint(layered)))
    assert (tmp_path / "journal").read_text() == ""


def test_full_disk_costs_the_note_only(layered, tmp_path, monkeypatch, caplog):
    def full(*_):
        raise OSError(28, "No space left on device")

    with Journal(tmp_path / "journal") as journal:
        monkeypatch.setattr(os, "write", full)
        for _ in range(2):
            journal.add(BatchResult(layered.input, layered.output, DONE, fingerprint=take_fingerprint(layered)))
    assert [entry.message for entry in caplog.records if "No space left" in entry.message] != []


def test_a_folder_is_written_to_by_one_batch_at_a_time(tmp_path):
    pytest.importorskip("fcntl")
    with Journal(tmp_path / "journal"), pytest.raises(BatchError, match="another batch"):
        Journal(tmp_path / "journal")


def test_resume_needs_a_journal(layered):
    with pytest.raises(OptionError, match="resume needs a journal"):
        batch([layered], resume=True)


def test_unknown_engine_is_refused(layered):
    with pytest.raises(OptionError, match="engine 'cloud'"):
        next(batch([layered], "cloud"))


class SlowEngine:
    """One that does a job with each look at it; `ended` says that its iterator was closed."""

    ended = False

    def run(self, jobs):
        try:
            for job in jobs:
                yield Started(job)
                yield Progressed(job, 0.5, "")
                yield Finished(job, BatchResult(job.input, job.output, "done"))
        finally:
            self.ended = True


def test_a_batch_is_cancelled_at_the_next_update_and_its_engine_closed(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    options = SimplifyOptions(ratio=0.5)
    jobs = [BatchJob(str(tmp_path / "in.usda"), str(tmp_path / f"o{n}.usda"), options) for n in range(3)]
    token, engine = threading.Event(), SlowEngine()
    results = batch(jobs, engine, cancel=token)
    assert next(results).output == jobs[0].output
    token.set()
    with pytest.raises(CancelledError, match="the batch was cancelled"):
        next(results)
    assert engine.ended
    with pytest.raises(CancelledError, match="before it began"):
        batch(jobs, SlowEngine(), cancel=token)
