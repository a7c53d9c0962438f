"""A batch as tasks on a Ray cluster of two nodes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import warpqem
from tests.support.usd_stages import cloth_stage
from warpqem.batching.engine import Started
from warpqem.batching.job_result import BatchResult
from warpqem.errors import OptionError
from warpqem.usd import SimplifyOptions

ray = pytest.importorskip("ray")

from ray.cluster_utils import Cluster  # noqa: E402

from warpqem.batching.ray_engine import RayEngine  # noqa: E402

COUNT = 8


@pytest.fixture(scope="module")
def cluster():
    # Workers import the tests' modules as this process does.
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join(sys.path)
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    cluster.add_node(num_cpus=1)
    ray.init(address=cluster.address, log_to_driver=False)
    yield cluster
    ray.shutdown()
    cluster.shutdown()
    os.environ.pop("PYTHONPATH")
    if before is not None:
        os.environ["PYTHONPATH"] = before


def jobs(folder: Path, output: str) -> list[warpqem.BatchJob]:
    options = SimplifyOptions(ratio=0.3, device="cpu")
    return [
        warpqem.BatchJob(str(folder / f"{name}.usda"), str(folder / output / f"{name}.usdc"), options)
        for name in [*map(str, range(COUNT)), "gone"]
    ]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("ray")
    for index in range(COUNT):
        cloth_stage(folder / f"{index}.usda", size=10 + index)
    return folder


def outputs(folder: Path, name: str) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (folder / name).iterdir()}


def run(folder: Path, name: str, on_update=None, **options: object) -> list[BatchResult]:
    engine = RayEngine(**options)
    return list(warpqem.batch(jobs(folder, name), engine, on_update=on_update))


@pytest.fixture(scope="module")
def local(folder) -> dict[str, bytes]:
    list(warpqem.batch(jobs(folder, "local")))
    return outputs(folder, "local")


def test_same_jobs_give_the_same_bytes_as_on_this_machine(cluster, folder, local):
    results = run(folder, "ray")
    assert outputs(folder, "ray") == local
    assert sorted(result.status for result in results) == ["done"] * COUNT + ["failed"]
    [failed] = [result for result in results if result.status == "failed"]
    assert failed.message == f"{folder / 'gone.usda'}: no such file"
    # Both nodes had their part, each in a process of its own.
    assert len({result.process for result in results}) >= 2


class Count:
    """How many tasks are with the cluster at a time, at most."""

    def __init__(self):
        self.open = self.most = 0

    def __call__(self, update):
        self.open += 1 if isinstance(update, Started) else -1
        self.most = max(self.most, self.open)


def test_no_more_tasks_are_handed_over_than_there_is_room_for(cluster, folder):
    count = Count()
    run(folder, "room", on_update=count)
    assert count.most == 2


def test_tasks_share_a_gpu_by_parts(cluster, folder, local):
    # One by its name: what a task has of it is the cluster's business, and it runs on the CPU here.
    node = cluster.add_node(num_cpus=3, num_gpus=1)
    cluster.wait_for_nodes()
    count = Count()
    run(folder, "parts", on_update=count, gpus=0.5)
    assert count.most == 2
    assert outputs(folder, "parts") == local
    cluster.remove_node(node)


def test_worker_that_is_killed_costs_nothing(cluster, folder, local):
    results = []
    updates = warpqem.batch(jobs(folder, "killed"), RayEngine())
    for result in updates:
        results.append(result)
        if len(results) == 2:
            os.kill(int(results[0].process.split(":")[1]), signal.SIGKILL)
    assert sorted(result.status for result in results) == ["done"] * COUNT + ["failed"]
    assert outputs(folder, "killed") == local


def trap(folder: Path, name: str) -> warpqem.BatchJob:
    from tests.support.batch_traps import TrapOptions

    options = TrapOptions(ratio=0.3, device="cpu", trap=name, marker=str(folder / f"{name} marker"))
    return warpqem.BatchJob(str(folder / "0.usda"), str(folder / name / "o.usdc"), options)


def test_attempts_are_counted_and_a_killed_one_leaves_nothing(cluster, folder):
    job = trap(folder, "killed while writing once")
    [result] = warpqem.batch([job], RayEngine())
    assert (result.status, result.attempts) == ("done", 2)
    assert set(outputs(folder, "killed while writing once")) == {"o.usdc"}


def test_job_whose_every_process_is_killed_is_lost_and_leaves_nothing(cluster, folder):
    [result] = warpqem.batch([trap(folder, "killed while writing")], RayEngine(retries=1))
    assert (result.error, result.attempts) == ("WorkerLost", 2)
    assert outputs(folder, "killed while writing") == {}


def test_batch_that_is_closed_leaves_nothing(cluster, folder):
    marker = folder / "hang while writing marker"
    updates = warpqem.batch([trap(folder, "hang while writing"), *jobs(folder, "hang while writing")], RayEngine())
    next(updates)
    while not marker.exists():
        time.sleep(0.05)
    assert any(name.startswith(".warpqem.") for name in outputs(folder, "hang while writing"))
    updates.close()
    assert not any(name.startswith(".warpqem.") for name in outputs(folder, "hang while writing"))


def test_handler_of_the_program_for_sigterm_stays():
    code = (
        "import ray, signal\n"
        "from warpqem.batching.ray_engine import RayEngine\n"
        "handler = lambda *_: None\n"
        "signal.signal(signal.SIGTERM, handler)\n"
        "RayEngine()._connect()\n"
        "assert ray.is_initialized()\n"
        "assert signal.getsignal(signal.SIGTERM) is handler\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)


def test_node_that_goes_away_costs_nothing(cluster, folder, local):
    node = cluster.add_node(num_cpus=1)
    cluster.wait_for_nodes()
    results = []
    for result in warpqem.batch(jobs(folder, "node"), RayEngine()):
        results.append(result)
        if len(results) == 2:
            cluster.remove_node(node)
    assert sorted(result.status for result in results) == ["done"] * COUNT + ["failed"]
    assert outputs(folder, "node") == local


def test_task_that_hangs_is_stopped(cluster, folder, monkeypatch):
    from tests.support.batch_traps import TrapOptions

    monkeypatch.setattr("warpqem.batching.ray_engine.START_SECONDS", 0.0)
    options = TrapOptions(ratio=0.3, device="cpu", trap="hang")
    job = warpqem.BatchJob(str(folder / "0.usda"), str(folder / "hang" / "o.usdc"), options)
    begun = time.monotonic()
    [result] = warpqem.batch([job], RayEngine(timeout=2.0))
    assert (result.error, result.status) == ("TimedOut", "failed")
    assert time.monotonic() - begun < 60


@pytest.mark.parametrize("value", [{"cpus": 0.0}, {"gpus": -1.0}, {"timeout": 0.0}, {"retries": -1}])
def test_engine_refuses_values_out_of_range(value):
    with pytest.raises(OptionError):
        RayEngine(**value)
