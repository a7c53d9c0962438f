"""A batch in processes of this machine, and what befalls them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from pxr import Usd, UsdGeom

import warpqem
from tests.support.batch_traps import TrapOptions
from tests.support.usd_stages import cloth_stage
from warpqem.batching import local_engine, perform_job
from warpqem.batching.engine import Progressed, Started
from warpqem.batching.job_result import BatchResult
from warpqem.batching.local_engine import LocalEngine
from warpqem.batching.perform_job import perform
from warpqem.errors import BatchError, OptionError
from warpqem.usd import SimplifyOptions

TRAPS = ("crash", "killed once", "memory", "full disk")
GOOD = ("first", "middle", "last")


class Run:
    """One batch: good assets, and one for each trap between them."""

    def __init__(self, folder: Path) -> None:
        cloth_stage(folder / "cloth.usda")
        self.input = folder / "cloth.usda"
        self.before = self.input.read_bytes()
        self.folder = folder / "out"
        jobs = []
        for name in (GOOD[0], TRAPS[0], GOOD[1], *TRAPS[1:], "gone", GOOD[2]):
            options = SimplifyOptions(ratio=0.5, device="cpu")
            if name in TRAPS:
                options = TrapOptions(ratio=0.5, device="cpu", trap=name, marker=str(folder / "marker"))
            source = folder / "gone.usda" if name == "gone" else self.input
            jobs.append(warpqem.BatchJob(str(source), str(self.folder / name / "o.usdc"), options))
        self.updates = []
        # Without a time limit, which an asset may pass where the machine is busy.
        engine = LocalEngine(workers=2, memory="1G")
        results = warpqem.batch(jobs, engine, on_update=self.updates.append)
        self.results = {Path(result.output).parent.name: result for result in results}

    def result(self, name: str) -> BatchResult:
        return self.results[name]


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Run:
    return Run(tmp_path_factory.mktemp("batch"))


@pytest.mark.parametrize("name", [*GOOD, "killed once"])
def test_every_good_asset_is_done_with_the_same_bytes(run, name):
    assert run.result(name).status == "done"
    stage = Usd.Stage.Open(run.result(name).output)
    assert len(UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth")).GetFaceVertexCountsAttr().Get()) in (63, 64)
    assert Path(run.result(name).output).read_bytes() == Path(run.result("first").output).read_bytes()


def test_hung_asset_is_stopped_and_costs_no_other(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    plain, trapped = SimplifyOptions(ratio=0.5, device="cpu"), TrapOptions(ratio=0.5, device="cpu", trap="hang")
    jobs = [
        warpqem.BatchJob(str(tmp_path / "in.usda"), str(tmp_path / name), options)
        for name, options in (("first.usdc", plain), ("hang.usdc", trapped), ("last.usdc", plain))
    ]
    engine = LocalEngine(workers=1, timeout=600.0)

    def limit_the_trap(update):
        # Good assets have all the time that a busy machine may take.
        if isinstance(update, Started):
            engine.timeout = 1.0 if "hang" in update.job.output else 600.0

    found = {Path(result.output).stem: result for result in warpqem.batch(jobs, engine, on_update=limit_the_trap)}
    assert (found["hang"].status, found["hang"].error) == ("failed", "TimedOut")
    assert f"{tmp_path / 'in.usda'}: not done after 1 s" in found["hang"].message
    assert [found[name].status for name in ("first", "last")] == ["done", "done"]
    assert not (tmp_path / "hang.usdc").exists()


def test_crash_names_the_asset_the_signal_and_the_last_words(run):
    assert run.result("crash").error == "WorkerLost"
    assert run.result("crash").message == (
        f"{run.input}: the process that had it was ended by SIGABRT (a library gave up)"
    )
    assert run.result("crash").attempts == 1


def test_asset_whose_worker_was_killed_is_done_again(run):
    assert run.result("killed once").attempts == 2


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux limits what is mapped")
def test_asset_that_takes_too_much_memory_is_refused(run):
    assert (run.result("memory").error, run.result("memory").status) == ("MemoryError", "failed")
    assert run.result("memory").message == f"{run.input}: out of memory"


def test_full_disk_is_named(run):
    assert run.result("full disk").error == "StageError"
    assert "No space left on device" in run.result("full disk").message


def test_input_that_is_gone_is_named(run):
    assert run.result("gone").message == f"{run.input.parent / 'gone.usda'}: no such file"


def test_what_failed_leaves_nothing_behind(run):
    found = [path for path in run.folder.rglob("*") if path.is_file()]
    assert {path.parent.name for path in found} == {*GOOD, "killed once"}
    assert {path.name for path in found} == {"o.usdc"}


def test_input_is_untouched(run):
    assert run.input.read_bytes() == run.before


def test_result_says_what_was_done_where_and_what_it_took(run):
    result = run.result("first")
    assert (result.faces, result.face_frames) == (128, 3 * 128)
    assert result.faces_after in (63, 64)
    assert result.report["prims"][0]["path"] == "/Root/Cloth"
    assert int(result.process.split(":")[1]) != os.getpid()
    assert result.peak_memory is None or result.peak_memory > 2**20


def test_updates_tell_what_begins_and_how_far_it_is(run):
    assert sum(isinstance(update, Started) for update in run.updates) == len(run.results) + 1
    assert any(isinstance(update, Progressed) for update in run.updates)


@pytest.mark.parametrize("value", [{"workers": 0}, {"timeout": 0.0}, {"retries": -1}, {"memory": "lots"}])
def test_engine_refuses_values_out_of_range(value):
    with pytest.raises(OptionError):
        LocalEngine(**value)


def test_there_are_no_more_workers_than_assets():
    assert [LocalEngine(4).worker_count(count, ["cpu"]) for count in (2, 6)] == [2, 4]


@pytest.mark.parametrize(
    ("cores", "devices", "expected"),
    [(16, 1, 4), (16, 2, 8), (2, 1, 2), (1, 1, 1), (2, 4, 4), (64, 8, 32)],
)
def test_a_gpu_has_some_workers_but_no_more_than_there_are_cores(cores, devices, expected, monkeypatch):
    monkeypatch.setattr(local_engine, "thread_count", lambda _: cores)
    named = [f"cuda:{number}" for number in range(devices)]
    assert LocalEngine().worker_count(100, named) == expected
    assert LocalEngine().worker_count(1, named) == 1
    assert LocalEngine(workers=3).worker_count(100, named) == 3


@pytest.mark.parametrize(("workers", "devices", "sharing"), [(4, 1, 4), (8, 2, 4), (3, 2, 2), (2, 4, 1)])
def test_workers_know_how_many_share_their_device(workers, devices, sharing):
    assert LocalEngine(memory="1G").setup(workers, "cuda:1", "out.txt", devices).sharing == sharing


def test_workers_that_share_a_device_share_its_memory(monkeypatch):
    monkeypatch.setattr(perform_job, "available_memory", lambda _: 1000)
    own, host = (replace(perform_job.device_traits("cpu"), own_memory=own) for own in (True, False))
    for traits, sharing, expected in ((own, 4, 200), (own, 1, 800), (host, 4, 800)):
        monkeypatch.setattr(perform_job, "device_traits", lambda _, traits=traits: traits)
        options = perform_job._with_defaults(SimplifyOptions(ratio=0.5), "cpu", 5000, sharing)
        assert options.memory == expected


def test_workers_that_cannot_start_end_the_batch(tmp_path, monkeypatch):
    cloth_stage(tmp_path / "in.usda")
    # USD is not to be found in a process that is started now.
    (tmp_path / "pxr.py").write_text("raise ImportError('no USD')")
    monkeypatch.syspath_prepend(str(tmp_path))
    job = warpqem.BatchJob(str(tmp_path / "in.usda"), str(tmp_path / "out.usda"), SimplifyOptions(ratio=0.5))
    with pytest.raises(BatchError, match=r"no worker can be started.*no USD"):
        list(warpqem.batch([job], LocalEngine(workers=1)))


def start(folder: Path, *more: str) -> subprocess.Popen:
    """`warpqem batch` over three files, in a process group of its own."""
    command = [sys.executable, "-m", "warpqem", "batch", str(folder / "in"), "-o", str(folder / "out")]
    options = ["--ratio", "0.3", "--device", "cpu", "--jobs", "1", "--json", "-", *more]
    return subprocess.Popen([*command, *options], stdout=subprocess.PIPE, text=True, start_new_session=True)


def inputs(folder: Path) -> Path:
    (folder / "in").mkdir()
    for name in ("a.usda", "b.usdc", "c.usd"):
        cloth_stage(folder / "in" / name, size=20)
    return folder


def outputs(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (folder / "out").glob("[!.]*")}


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> dict[str, bytes]:
    folder = inputs(tmp_path_factory.mktemp("undisturbed"))
    start(folder).communicate()
    return outputs(folder)


@pytest.mark.skipif(os.name != "posix", reason="signals")
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT], ids=["kill", "interrupt"])
def test_batch_that_is_stopped_goes_on_to_the_same_bytes(tmp_path, undisturbed, how):
    process = start(inputs(tmp_path))
    assert '"status": "done"' in process.stdout.readline()
    process.send_signal(how)
    process.stdout.read()
    assert process.wait() != 0
    before = outputs(tmp_path)
    assert before.items() <= undisturbed.items()
    lines = start(tmp_path, "--resume").communicate()[0].splitlines()
    assert len(lines) == 3
    assert '"status": "skipped"' in lines[0]
    assert outputs(tmp_path) == undisturbed
    assert set(undisturbed) == {"a.usda", "b.usdc", "c.usd"}
    assert not list((tmp_path / "out").glob(".warpqem.*"))


def test_folder_that_cannot_be_made_is_named_and_costs_no_other(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    (tmp_path / "file").write_text("")
    options = SimplifyOptions(ratio=0.5, device="cpu")
    places = ("file/o.usda", "o.usda")
    jobs = [warpqem.BatchJob(str(tmp_path / "in.usda"), str(tmp_path / place), options) for place in places]
    first, second = (perform(job) for job in jobs)
    assert (first.status, second.status) == ("failed", "done")
    assert f"{tmp_path / 'file'}: the folder cannot be made" in first.message


@pytest.mark.skipif(os.name != "posix" or os.getuid() == 0, reason="root writes anywhere")
def test_read_only_folder_is_named(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    (tmp_path / "out").mkdir(mode=0o500)
    result = perform(
        warpqem.BatchJob(str(tmp_path / "in.usda"), str(tmp_path / "out/o.usda"), SimplifyOptions(ratio=0.5))
    )
    assert (result.status, result.error) == ("failed", "StageError")
    assert str(tmp_path / "out") in result.message
