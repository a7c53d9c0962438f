"""Files that are not read or written here: their errors say how to convert them."""

from __future__ import annotations

import re

import pytest

from tests.support.cli import run
from tests.support.usd_stages import cloth_stage
from warpqem.files.formats import how_to_read, how_to_write

COMMANDS = {
    "simplify": ("-o", "out.usda", "--ratio", "0.5"),
    "info": (),
    "render": ("-o", "out.png"),
}


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(("suffix", "program"), [(".fbx", "Blender"), (".ABC", "Blender"), (".mb", "Maya")])
def test_input_of_another_program_is_an_error_that_says_how_to_convert_it(
    tmp_path, monkeypatch, command, suffix, program
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / f"body{suffix}").write_bytes(b"Kaydara FBX Binary  \x00")
    done = run(command, f"body{suffix}", *COMMANDS[command])
    assert done.exit_code == 1
    [line] = done.stderr.splitlines()
    assert line.startswith(f"error: body{suffix}: {suffix.lower()} is ")
    assert "which is not read; convert it to USD: in " + program in line
    assert [path.name for path in tmp_path.iterdir()] == [f"body{suffix}"]


def test_a_batch_says_so_of_each_file_and_does_the_others(tmp_path):
    cloth_stage(tmp_path / "good.usda")
    (tmp_path / "bad.fbx").write_bytes(b"Kaydara FBX Binary")
    options = ("--ratio", 0.5, "--device", "cpu", "--jobs", 1)
    done = run("batch", tmp_path / "good.usda", tmp_path / "bad.fbx", "-o", tmp_path / "out", *options)
    assert f"error: {tmp_path / 'bad.fbx'}: .fbx is FBX, which is not read" in done.stderr
    assert (tmp_path / "out" / "good.usda").exists()


@pytest.mark.parametrize("name", ["body.xyz1", "body"])
def test_input_of_no_known_format_names_those_that_are_read(tmp_path, name):
    (tmp_path / name).write_bytes(b"whatever")
    done = run("info", tmp_path / name)
    assert done.exit_code == 1
    assert "none of the formats that are read: USD (.usd, .usda, .usdc, .usdz), .glb" in done.stderr


def test_a_missing_file_is_missing_whatever_its_name(tmp_path):
    assert run("info", tmp_path / "body.fbx").stderr == f"error: {tmp_path / 'body.fbx'}: no such file\n"


@pytest.mark.parametrize(("suffix", "known"), [(".fbx", True), (".abc", True), (".usdx", False), ("", False)])
def test_output_of_another_program_is_an_error_that_says_how_to_get_it(tmp_path, suffix, known):
    cloth_stage(tmp_path / "in.usda")
    done = run("simplify", tmp_path / "in.usda", "-o", tmp_path / f"out{suffix}", "--ratio", "0.5")
    assert done.exit_code == 2
    assert "the suffix must be one of .usd" in done.stderr
    assert ("write a .usd file, and convert that: in Blender" in done.stderr) == known


def test_every_hint_is_one_line_that_names_the_suffix():
    from warpqem.files import formats

    for suffix, known in formats._FORMATS.items():
        text = how_to_read(f"a/body{suffix.upper()}")
        assert text.startswith(f"{suffix} is {known.name}, ")
        assert not re.search(r"\n|  ", text + how_to_write(f"body{suffix}"))
