"""Frames of one mesh placed by several processes: the same bits, whatever the others do."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import warpqem
from tests.support.frame_stream import FACES, POINTS
from warpqem.errors import OptionError
from warpqem.pipeline.shared_frames import FrameShare, help_place

COUNT = 3


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch):
    monkeypatch.setattr("warpqem.pipeline.memory_plan.BLOCK_BYTES", 1)


def simplify(share: FrameShare | None, **options: object) -> warpqem.SimplifiedMesh:
    return warpqem.simplify(POINTS, FACES, ratio=0.3, key_frames=4, share=share, **{"device": "cpu", **options})


def shared(folder: Path, call: Callable[[Path], None], **options: object) -> FrameShare:
    return FrameShare(lambda: folder / "share", call, **{"min_bytes": 0, **options})


@pytest.mark.parametrize("options", [{}, {"refit": True}, {"placement": "endpoint"}], ids=str)
def test_frames_that_others_place_have_the_same_bits(tmp_path, options, device):
    counts = []
    share = shared(tmp_path, lambda folder: counts.append(help_place(folder, device)))
    alone, together = simplify(None, device=device, **options), simplify(share, device=device, **options)
    assert (counts, alone.plan.block_count) == ([COUNT], COUNT)
    for name in ("points", "faces", "flips"):
        np.testing.assert_array_equal(getattr(together, name), getattr(alone, name), err_msg=name)


def test_another_process_reads_and_places_the_frames(tmp_path):
    code = "import sys, warpqem; print(warpqem.help_place(sys.argv[1]))"
    told = []

    def call(folder: Path) -> None:
        told.append(subprocess.run([sys.executable, "-c", code, folder], capture_output=True, text=True, check=True))

    together = simplify(shared(tmp_path, call))
    assert told[0].stdout.split()[-1] == str(COUNT)
    np.testing.assert_array_equal(together.points, simplify(None).points)


def test_blocks_that_were_claimed_and_never_delivered_are_placed_all_the_same(tmp_path):
    def reservation(folder: Path) -> None:
        for first in (8, 16):
            (folder / f"{first}.claimed").touch()
        # One died while it wrote.
        (folder / "16.part").write_bytes(b"half")

    np.testing.assert_array_equal(simplify(shared(tmp_path, reservation)).points, simplify(None).points)


def test_blocks_are_each_claimed_once(tmp_path):
    counts = []

    def call(folder: Path) -> None:
        (folder / "8.claimed").touch()
        counts.extend(help_place(folder) for _ in range(2))

    simplify(shared(tmp_path, call))
    assert counts == [COUNT - 1, 0]


def test_folder_is_gone_afterwards_and_a_late_helper_finds_nothing_to_do(tmp_path):
    folders = []
    simplify(shared(tmp_path, folders.append))
    assert folders == [tmp_path / "share"]
    assert not folders[0].exists()
    assert help_place(folders[0]) == 0


def test_folder_is_gone_after_an_error(tmp_path):
    def call(folder: Path) -> None:
        raise InterruptedError("the network is down")

    with pytest.raises(InterruptedError):
        simplify(shared(tmp_path, call))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name != "posix", reason="modes of files")
def test_folder_is_for_its_user_alone(tmp_path):
    modes = []
    simplify(shared(tmp_path, lambda folder: modes.append(folder.stat().st_mode & 0o777)))
    assert modes == [0o700]


def test_small_mesh_is_not_shared(tmp_path):
    calls = []
    simplify(shared(tmp_path, calls.append, min_bytes=POINTS.nbytes + 1))
    assert calls == []


@dataclass
class LockedFrames:
    """Frames that only this process can read."""

    frame_count: int = POINTS.shape[0]
    vertex_count: int = POINTS.shape[1]
    dtype: np.dtype = POINTS.dtype

    def read(self, frames: slice) -> np.ndarray:
        return POINTS[frames]

    def __reduce__(self):
        raise TypeError("cannot pickle a lock")


def test_source_that_no_other_process_can_read_is_an_error(tmp_path):
    with pytest.raises(OptionError, match=r"share: frames cannot be read in another process \(cannot pickle a lock\)"):
        warpqem.simplify(LockedFrames(), FACES, ratio=0.3, share=shared(tmp_path, print), device="cpu")


def test_levels_are_shared_too(tmp_path):
    counts = []
    order = warpqem.order_levels(POINTS, FACES, target_faces=64, device="cpu")
    share = shared(tmp_path, lambda folder: counts.append(help_place(folder)))
    np.testing.assert_array_equal(order.level(100, share=share).points, order.level(100).points)
    assert counts == [COUNT]
