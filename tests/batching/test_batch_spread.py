"""Frames of one asset of a batch, placed by workers that have no asset left."""

from __future__ import annotations

from pathlib import Path

import pytest

import warpqem
from tests.support.batch_traps import TrapOptions
from tests.support.usd_stages import cloth_stage
from tests.support.usd_stream import TIMES
from warpqem.batching.local_engine import LocalEngine
from warpqem.usd import SimplifyOptions


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("spread")
    cloth_stage(folder / "in.usda", times=TIMES)
    [result] = warpqem.batch([job(folder, "alone", SimplifyOptions(ratio=0.5, device="cpu"))], LocalEngine(1))
    assert result.status == "done"
    return folder


def job(folder: Path, name: str, options: SimplifyOptions) -> warpqem.BatchJob:
    return warpqem.BatchJob(str(folder / "in.usda"), str(folder / name / "o.usdc"), options)


@pytest.mark.parametrize("name", ["helped", "helper killed"])
def test_output_is_the_same_whoever_helps(folder, name):
    options = TrapOptions(ratio=0.5, device="cpu", trap=name, marker=str(folder / f"{name} marker"))
    # One asset and two processes: the second has nothing to do but to help.
    [result] = warpqem.batch([job(folder, name, options)], LocalEngine(2, spread=True))
    assert (result.status, result.attempts) == ("done", 1)
    assert (folder / f"{name} marker").exists()
    assert (folder / name / "o.usdc").read_bytes() == (folder / "alone" / "o.usdc").read_bytes()
    assert [path.name for path in (folder / name).iterdir()] == ["o.usdc"]


def test_there_are_no_more_workers_than_assets_unless_they_may_help():
    assert [LocalEngine(4, spread=spread).worker_count(2, ["cpu"]) for spread in (False, True)] == [2, 4]
