"""Progressive files that are none or do not stay as they are, and what the commands say of them."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tests.support.progressive_files import (
    NOTES,
    changed,
    zeros,
)
from warpqem.cli.main import app
from warpqem.errors import ProgressiveFileError
from warpqem.progressive import load, read_info, save, stream
from warpqem.progressive.file import ProgressiveFile

# Files that are none, or do not stay as they are.


@pytest.mark.skipif(os.name != "posix", reason="pipes and devices in folders")
def test_what_is_no_regular_file_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe.wpqm")
    for path in (tmp_path, tmp_path / "pipe.wpqm", Path("/dev/zero"), Path("/dev/null")):
        for use in (load, read_info, lambda path: list(stream(path))):
            with pytest.raises(ProgressiveFileError, match="no regular file"):
                use(path)


def test_file_that_is_cut_short_while_it_is_streamed_is_named(good):
    meshes_so_far = stream(good)
    assert next(meshes_so_far).split_count == 0
    os.truncate(good, good.stat().st_size // 2)
    with pytest.raises(ProgressiveFileError, match=r"good\.wpqm: the file has become shorter while it was read"):
        next(meshes_so_far)


def test_chunk_that_is_changed_while_it_is_streamed_is_named(good):
    meshes_so_far = stream(good)
    next(meshes_so_far)
    with open(good, "r+b") as file:
        file.seek(-20, os.SEEK_END)
        file.write(bytes(20))
    with pytest.raises(ProgressiveFileError, match=r"good\.wpqm: chunk 1 is damaged"):
        next(meshes_so_far)


def test_open_file_stays_the_one_that_was_opened(good, sphere, tmp_path):
    with ProgressiveFile(good) as file:
        save(sphere, tmp_path / "other.wpqm", {**NOTES, "times": [7.0, 8.0, 9.0]})
        os.replace(tmp_path / "other.wpqm", good)
        assert file.load().frame_count == len(file.info.extra["times"])
        assert file.info.extra["times"] == [1.0, 2.0, 3.0]


# The command line.


def test_commands_name_what_is_wrong_with_a_file(good):
    bad = changed(good, 1, 6, zeros(2**31))
    for arguments in (
        ["extract", str(bad), "-o", str(bad.with_suffix(".usda")), "--ratio", "1"],
        ["info", str(good.parent)],
    ):
        done = CliRunner().invoke(app, ["progressive", *arguments])
        assert done.exit_code == 1
        assert done.stderr.startswith(f"error: {arguments[1]}: ")
        assert len(done.stderr.splitlines()) == 1
    done = CliRunner().invoke(app, ["view", str(bad), "--no-browser"])
    assert done.exit_code == 1
    assert f"error: {bad}: chunk 1: {2**31} bytes where" in done.stderr


def test_memory_is_an_option_of_commands_that_load(good):
    arguments = ["progressive", "extract", str(good), "-o", str(good.with_suffix(".usda")), "--ratio", "1"]
    assert CliRunner().invoke(app, [*arguments, "--memory", "1K"]).exit_code == 1
    assert CliRunner().invoke(app, [*arguments, "--memory", "x"]).exit_code == 2
    assert CliRunner().invoke(app, [*arguments, "--memory", "1G"]).exit_code == 0
    assert CliRunner().invoke(app, ["view", "in.usda", "--memory", "1G"]).exit_code == 2
