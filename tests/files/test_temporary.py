"""Temporary files: written under names of their own, and removed when their process was killed."""

from __future__ import annotations

import os
import subprocess
import sys
import uuid
from dataclasses import replace
from pathlib import Path

import pytest

import warpqem.files.temporary as temporary
from warpqem.files.temporary import (
    mark_temporary,
    remove_leftovers,
    remove_marked,
    remove_path,
    replacing,
    temporary_path,
)
from warpqem.runtime.processes import ProcessId, own_id

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are not asked elsewhere")

OTHER = "00000000"


def left_by(folder: Path, process: ProcessId, **names: str) -> Path:
    """A temporary file of a process; ``names`` gives another machine or boot."""
    machine = names.get("machine", temporary._machine())
    boot = names.get("boot", temporary._boot())
    path = folder / f".warpqem.{machine}-{boot}-{process.number}-{process.started}.{uuid.uuid4().hex}.usdc"
    path.touch()
    return path


def ended_process() -> ProcessId:
    process = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    known = ProcessId.of(process.pid)
    process.communicate(b"\n")
    return known


def test_own_name_is_that_of_a_living_process(tmp_path):
    path = temporary_path(tmp_path, ".usdc")
    path.touch()
    assert remove_leftovers(tmp_path) == []
    assert path.exists()


def test_what_a_living_process_writes_stays(tmp_path):
    path = left_by(tmp_path, own_id())
    assert remove_leftovers(tmp_path) == []
    assert path.exists()


def test_what_a_dead_process_left_goes(tmp_path):
    path = left_by(tmp_path, ended_process())
    assert remove_leftovers(tmp_path) == [path]
    assert not path.exists()


def test_what_a_process_left_goes_before_its_parent_has_asked_how_it_ended(tmp_path):
    process = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    path = left_by(tmp_path, ProcessId.of(process.pid))
    process.stdin.write(b"\n")
    process.stdin.close()
    os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
    assert remove_leftovers(tmp_path) == [path]
    process.wait()


def test_what_a_dead_process_left_goes_where_its_id_has_been_given_out_again(tmp_path):
    path = left_by(tmp_path, replace(own_id(), started=own_id().started - 1))
    assert remove_leftovers(tmp_path) == [path]


def test_what_another_machine_writes_stays(tmp_path):
    left_by(tmp_path, ended_process(), machine=OTHER)
    assert remove_leftovers(tmp_path) == []


@pytest.mark.parametrize("container", [True, False])
@pytest.mark.parametrize("age", ["older", "newer"])
def test_what_is_older_than_the_start_of_the_machine_goes(tmp_path, monkeypatch, container, age):
    path = left_by(tmp_path, own_id(), boot=OTHER)
    if age == "older":
        os.utime(path, (1e9, 1e9))
    monkeypatch.setattr(temporary, "_namespace", lambda: "pid:[1]" if container else temporary.FIRST_NAMESPACE)
    # Of a container nobody can say when its machine started.
    assert remove_leftovers(tmp_path) == ([path] if age == "older" and not container else [])


def test_files_of_another_user_stay(tmp_path, monkeypatch):
    left_by(tmp_path, ended_process())
    user = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: user + 1)
    assert remove_leftovers(tmp_path) == []


def test_what_usd_was_writing_under_a_name_of_its_own_goes_too(tmp_path):
    path = left_by(tmp_path, replace(own_id(), number=11))
    path = path.rename(path.with_suffix(".rCuh2N"))
    assert remove_leftovers(tmp_path, 11) == [path]


def test_only_what_one_process_left_goes_where_it_is_named(tmp_path):
    one, other = (left_by(tmp_path, ProcessId(number, 5)) for number in (11, 12))
    assert remove_leftovers(tmp_path, 11) == [one]
    assert other.exists()


def test_folder_that_a_dead_process_left_goes_with_all_that_is_in_it(tmp_path):
    path = left_by(tmp_path, ended_process())
    path.unlink()
    path.mkdir()
    (path / "0.claimed").touch()
    assert remove_leftovers(tmp_path) == [path]
    assert os.listdir(tmp_path) == []


def test_folder_that_another_thread_is_removing_is_gone_when_both_have_been_asked_to(tmp_path, monkeypatch):
    folder = temporary_path(tmp_path, ".batch")
    folder.mkdir()
    (folder / "1.txt").write_text("x")
    # The end of the process stops the other one after its first step.
    with monkeypatch.context() as stopped:
        stopped.setattr(temporary.shutil, "rmtree", lambda path, **options: None)
        remove_path(folder)
    assert os.listdir(tmp_path)
    remove_path(folder)
    assert os.listdir(tmp_path) == []


def test_link_of_such_a_name_goes_and_what_it_leads_to_stays(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "file").touch()
    path = left_by(tmp_path, ended_process())
    path.unlink()
    path.symlink_to(tmp_path / "mine")
    assert remove_leftovers(tmp_path) == [path]
    assert (tmp_path / "mine" / "file").exists()


def test_first_name_in_a_folder_removes_what_was_left_there(tmp_path):
    path = left_by(tmp_path, ended_process())
    temporary_path(tmp_path, ".usdc")
    assert not path.exists()


def test_files_of_others_stay(tmp_path):
    for name in (".warpqem.notes.usda", "warpqem.usda", ".warpqem.00000000-1.aa.usdc", ".warpqem-batch.jsonl"):
        (tmp_path / name).touch()
    assert remove_leftovers(tmp_path) == []


def test_folder_that_is_missing_has_nothing_left_in_it(tmp_path):
    assert remove_leftovers(tmp_path / "gone") == []


def test_files_with_a_mark_go_whichever_machine_they_are_of(tmp_path):
    with mark_temporary("0123456789abcdef"):
        marked = temporary_path(tmp_path, ".usdc")
    other = temporary_path(tmp_path, ".usdc")
    elsewhere = marked.with_name(marked.name.replace(temporary._machine(), OTHER))
    for path in (marked, other, elsewhere):
        path.touch()
    assert set(remove_marked(tmp_path, "0123456789abcdef")) == {marked, elsewhere}
    assert other.exists()


@pytest.mark.parametrize("error", [OSError, KeyboardInterrupt, SystemExit])
def test_file_that_is_not_finished_replaces_nothing_and_goes(tmp_path, error):
    target = tmp_path / "out.usda"
    target.write_text("before")

    def write() -> None:
        with replacing(target) as path:
            path.write_text("half")
            raise error

    with pytest.raises(error):
        write()
    assert target.read_text() == "before"
    assert os.listdir(tmp_path) == ["out.usda"]


@pytest.mark.parametrize("name", ["out.usda", "out", "out.we ird", ".hidden"])
def test_name_for_any_target_is_known_as_temporary(tmp_path, name):
    with replacing(tmp_path / name) as path:
        assert temporary.PATTERN.fullmatch(path.name)
        path.write_text("whole")
    assert (tmp_path / name).read_text() == "whole"
