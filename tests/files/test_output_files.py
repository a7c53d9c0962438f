"""No output is a file that is read: how files are told to be the same, and what a stage reads."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
from pxr import UsdUtils

from tests.support.shots import ROLES, cloth_text, file_bytes, write_shot
from warpqem.errors import OptionError
from warpqem.files.outputs import InputFile, OutputFile, OutputFiles, check_outputs, named_outputs
from warpqem.usd.checks.input_files import check_stage_outputs, stage_files
from warpqem.usd.read.open_stage import open_stage


@pytest.fixture(scope="module")
def shot(tmp_path_factory) -> Path:
    """A shot of many files, which no test changes."""
    return write_shot(tmp_path_factory.mktemp("shot"))


def refusal(outputs: list[OutputFile], *inputs: InputFile) -> str:
    with pytest.raises(OptionError) as error:
        check_outputs(outputs, inputs)
    return str(error.value)


@pytest.mark.parametrize("name", ["in.txt", "./in.txt", "folder/../in.txt", "link", "hard", "chain", "linked/in.txt"])
def test_file_is_the_same_by_any_name(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "in.txt").write_text("kept")
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to("in.txt")
    (tmp_path / "chain").symlink_to("link")
    (tmp_path / "linked").symlink_to(tmp_path, target_is_directory=True)
    os.link("in.txt", "hard")
    said = refusal([OutputFile("--json", name)], InputFile(tmp_path / "in.txt", "a texture"))
    assert said == f"--json {name}: this is a texture, which is never overwritten"
    assert refusal([OutputFile("output", tmp_path / "in.txt")], InputFile(name)).endswith("overwritten")


@pytest.mark.parametrize("name", ["gone.txt", "nowhere/../gone.txt", "link"])
def test_file_that_is_missing_is_known_by_its_place(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "link").symlink_to("gone.txt")
    assert "this is the input" in refusal([OutputFile("output", name)], InputFile(tmp_path / "gone.txt"))


def test_other_files_are_free(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("in.txt", "older.txt", "IN.TXT"):
        (tmp_path / name).write_text("")
    names = ("older.txt", "new.txt", "IN.TXT") if len(list(tmp_path.iterdir())) == 3 else ("older.txt", "new.txt")
    check_outputs([OutputFile(name, name) for name in names], [InputFile("in.txt"), InputFile("gone.txt")])


def test_name_in_another_case_is_the_same_file_where_the_folder_ignores_case(tmp_path, monkeypatch):
    monkeypatch.setattr("warpqem.files.outputs._ignores_case", lambda folder: True)
    outputs = [OutputFile("--json", tmp_path / "A.json"), OutputFile("--report", tmp_path / "a.JSON")]
    assert "is the same file" in refusal(outputs)


@pytest.mark.parametrize("name", ["a.txt", "link.txt", "./a.txt"])
def test_two_outputs_are_two_files(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "link.txt").symlink_to("a.txt")
    said = refusal([OutputFile("output", "a.txt"), OutputFile("--json", name)])
    assert said == f"--json {name}: output a.txt is the same file, and only one can be written"


def test_devices_may_be_written_twice_and_read():
    outputs = [OutputFile("output", os.devnull), OutputFile("--json", os.devnull)]
    check_outputs(outputs, [InputFile(os.devnull)])


def test_link_to_a_folder_is_no_output(tmp_path):
    (tmp_path / "link.json").symlink_to(tmp_path, target_is_directory=True)
    assert "this is a folder" in refusal([OutputFile("--json", tmp_path / "link.json")])


def test_standard_output_is_no_file():
    assert named_outputs({"--json": "-", "--report": None, "output": "a"}) == [OutputFile("output", "a")]


@pytest.mark.parametrize("name", ["a\0b", "x" * 5000])
def test_names_that_no_file_can_have_are_not_looked_at(name):
    check_outputs([OutputFile("output", "a")], [InputFile(name)])


@pytest.mark.parametrize("name", ROLES)
def test_every_file_of_a_shot_is_named_with_its_role(shot, name):
    with pytest.raises(OptionError) as error:
        check_stage_outputs([OutputFile("--json", shot.parent / name)], [open_stage(shot)])
    role = ROLES[name].format(root=shot, folder=shot.parent)
    assert str(error.value) == f"--json {shot.parent / name}: this is {role}, which is never overwritten"


def test_no_file_of_a_shot_is_left_out(shot):
    stage, outputs = open_stage(shot), OutputFiles([OutputFile("output", shot.parent / "map.png")])
    found = {Path(file.path).name for file in stage_files(stage, outputs)}
    assert found >= {path.name for path in shot.parent.iterdir()}


@pytest.mark.parametrize("name", ["tile.1009.png", "tile.1001.jpg", "tile.100.png", "published.usda", "new.usda"])
def test_what_would_become_a_part_of_a_set_of_tiles_is_refused_and_nothing_else(shot, name):
    outputs = [OutputFile("output", shot.parent / name)]
    if name == "tile.1009.png":
        if not hasattr(UsdUtils, "ExtractExternalReferencesParams"):
            pytest.skip("this version of USD lists the tiles that are there, not the name of the set")
        with pytest.raises(OptionError, match=r"a texture of /Root/Props\.tiles"):
            check_stage_outputs(outputs, [open_stage(shot)])
    else:
        check_stage_outputs(outputs, [open_stage(shot)])


def test_name_that_an_asset_gives_itself_may_be_written(tmp_path):
    shot = write_shot(tmp_path)
    (tmp_path / "published.usda").write_text("#usda 1.0\n")
    check_stage_outputs([OutputFile("output", tmp_path / "published.usda")], [open_stage(shot)])


@pytest.mark.parametrize("arc", ["subLayers = [@./gone.usda@]", "subLayers = [@gone.usda@]"])
def test_layer_that_is_missing_is_not_to_be_written(tmp_path, arc):
    (tmp_path / "in.usda").write_text(f"#usda 1.0\n(\n    {arc}\n)\n")
    with pytest.raises(OptionError, match=r"gone\.usda: this is a sublayer of"):
        check_stage_outputs([OutputFile("output", tmp_path / "gone.usda")], [open_stage(tmp_path / "in.usda")])


@pytest.mark.parametrize("name", ["file:./geo.usd", "file:{folder}/geo.usd", "file://{folder}/geo.usd"])
def test_file_named_by_an_address_is_the_file(tmp_path, name):
    (tmp_path / "geo.usd").write_text(cloth_text())
    text = name.format(folder=tmp_path)
    (tmp_path / "in.usda").write_text(f"#usda 1.0\n(\n    subLayers = [@{text}@]\n)\n")
    with pytest.raises(OptionError, match=r"geo\.usd: this is a sublayer of"):
        check_stage_outputs([OutputFile("output", tmp_path / "geo.usd")], [open_stage(tmp_path / "in.usda")])


def test_layer_with_arguments_of_its_format_is_the_file(tmp_path):
    (tmp_path / "geo.usd").write_text(cloth_text())
    (tmp_path / "in.usda").write_text("#usda 1.0\n(\n    subLayers = [@./geo.usd:SDF_FORMAT_ARGS:target=usd@]\n)\n")
    with pytest.raises(OptionError, match="a sublayer of"):
        check_stage_outputs([OutputFile("output", tmp_path / "geo.usd")], [open_stage(tmp_path / "in.usda")])


def test_package_is_the_input_and_what_is_in_it(tmp_path):
    shot = write_shot(tmp_path)
    package = shot.with_name("packed.usdz")
    with pytest.raises(OptionError, match="this is the input"):
        check_stage_outputs([OutputFile("output", package)], [open_stage(package)])


def test_folder_with_brackets_is_no_package(tmp_path):
    folder = tmp_path / "take[1]"
    folder.mkdir()
    shot = write_shot(folder)
    for name in ("map.png", "packed.usdz"):
        with pytest.raises(OptionError, match=re.escape(f"{name}: this is a")):
            check_stage_outputs([OutputFile("output", folder / name)], [open_stage(shot)])


def test_file_that_usd_cannot_read_is_kept_too(tmp_path):
    (tmp_path / "in.usda").write_text('#usda 1.0\ndef "A" (\n    references = @./model.abc@\n)\n{\n}\n')
    with pytest.raises(OptionError, match="a reference of /A"):
        check_stage_outputs([OutputFile("output", tmp_path / "model.abc")], [open_stage(tmp_path / "in.usda")])


def test_looking_changes_nothing(shot):
    before = file_bytes(shot.parent)
    stage = open_stage(shot)
    stage_files(stage, OutputFiles([OutputFile("output", shot.parent / "map.png")]))
    assert not any(layer.dirty for layer in stage.GetUsedLayers(includeClipLayers=True))
    assert file_bytes(shot.parent) == before
