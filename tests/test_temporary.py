"""Temporary files of processes that were killed."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from warpqem.temporary import remove_leftovers, temporary_path

pytestmark = pytest.mark.skipif(os.name != "posix", reason="processes are not asked elsewhere")


def left_by(folder, process: int):
    path = temporary_path(folder, ".usdc")
    path = path.with_name(path.name.replace(f"-{os.getpid()}.", f"-{process}."))
    path.touch()
    return path


def test_what_a_living_process_writes_stays(tmp_path):
    path = left_by(tmp_path, os.getpid())
    assert remove_leftovers(tmp_path) == []
    assert path.exists()


@pytest.mark.parametrize("reaped", [True, False])
def test_what_a_dead_process_left_goes(tmp_path, reaped):
    process = subprocess.Popen([sys.executable, "-c", "pass"], stdout=subprocess.PIPE)
    process.stdout.read()
    if reaped:
        process.wait()
    else:
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
    path = left_by(tmp_path, process.pid)
    assert remove_leftovers(tmp_path) == [path]
    assert not path.exists()
    process.wait()


def test_what_usd_was_writing_under_a_name_of_its_own_goes_too(tmp_path):
    path = left_by(tmp_path, 11)
    path = path.rename(path.with_suffix(".rCuh2N"))
    assert remove_leftovers(tmp_path, 11) == [path]


def test_only_what_one_process_left_goes_where_it_is_named(tmp_path):
    one, other = left_by(tmp_path, 11), left_by(tmp_path, 12)
    assert remove_leftovers(tmp_path, 11) == [one]
    assert other.exists()


def test_folder_that_a_dead_process_left_goes_with_all_that_is_in_it(tmp_path):
    process = subprocess.Popen([sys.executable, "-c", "pass"])
    process.wait()
    path = left_by(tmp_path, process.pid)
    path.unlink()
    path.mkdir()
    (path / "0.claimed").touch()
    assert remove_leftovers(tmp_path) == [path]
    assert not path.exists()


def test_files_of_others_stay(tmp_path):
    for name in (".warpqem.notes.usda", "warpqem.usda", ".warpqem.00000000-1.aa.usdc", ".warpqem-batch.jsonl"):
        (tmp_path / name).touch()
    assert remove_leftovers(tmp_path) == []


def test_folder_that_is_missing_has_nothing_left_in_it(tmp_path):
    assert remove_leftovers(tmp_path / "gone") == []
