"""Frames of a mesh on a stage, read and placed by another process too."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.usd_stages import cloth_stage
from tests.support.usd_stream import STAGES, TIMES, text_of, written
from warpqem.pipeline.shared_frames import FrameShare, help_place
from warpqem.usd import SimplifyOptions, simplify_stage

OPTIONS = {"ratio": 0.3, "device": "cpu"}
# Stages whose poses fit in one block, however small.
TOO_FEW_POSES = ("skinned", "baked", "rich", "rich levels")


def written_together(folder: Path, name: str, call, **options: object) -> str:
    share = FrameShare(lambda: folder / "share", call, min_bytes=0)
    simplify_stage(folder / "in.usda", folder / name, SimplifyOptions(**(OPTIONS | options)), share=share)
    return text_of(folder / name)


@pytest.mark.parametrize("name", STAGES)
def test_file_is_the_same_whoever_places_the_frames(name, tmp_path, in_small_blocks):
    make, options = STAGES[name]
    make(tmp_path / "in.usda")
    in_small_blocks()
    alone = written(tmp_path, "alone.usda", **options)
    counts = []
    together = written_together(tmp_path, "together.usda", lambda folder: counts.append(help_place(folder)), **options)
    assert together == alone
    assert all(counts)
    assert bool(counts) == (name not in TOO_FEW_POSES)


def test_example_poses_are_read_by_another_process(tmp_path, clip, in_small_blocks):
    cloth_stage(tmp_path / "in.usda")
    cloth_stage(tmp_path / "clip.usda", times=TIMES)
    in_small_blocks()
    told = []

    def call(folder: Path) -> None:
        code = "import sys, warpqem; print(warpqem.help_place(sys.argv[1]))"
        told.append(subprocess.run([sys.executable, "-c", code, folder], capture_output=True, text=True, check=True))

    alone = written(tmp_path, "alone.usda", poses=clip)
    assert written_together(tmp_path, "together.usda", call, poses=clip) == alone
    assert int(told[0].stdout.split()[-1]) == 3


def test_another_folder_to_work_in_changes_nothing(tmp_path, monkeypatch, in_small_blocks):
    cloth_stage(tmp_path / "in.usda", times=TIMES)
    in_small_blocks()
    monkeypatch.chdir(tmp_path)
    counts = []

    def call(folder: Path) -> None:
        os.chdir("/")
        counts.append(help_place(folder))
        os.chdir(tmp_path)

    share = FrameShare(lambda: tmp_path / "share", call, min_bytes=0)
    simplify_stage("in.usda", "out.usda", SimplifyOptions(**OPTIONS), share=share)
    assert counts == [3]
