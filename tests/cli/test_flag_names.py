"""Messages of the command line name flags; in Python the same errors name arguments."""

from __future__ import annotations

import pickle
import re

import numpy as np
import pytest

import warpqem
from tests.support import meshes
from tests.support.cli import run
from tests.support.usd_stages import cloth_stage
from warpqem.batching.jobs import find_files
from warpqem.cli.flag_names import error_text, flags_of_options, with_flags
from warpqem.errors import OptionError, StageError
from warpqem.usd import SimplifyOptions, inspect_stage
from warpqem.usd.commands.option_values import read_options

FLAGS = flags_of_options(SimplifyOptions)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--ratio", "2"], "--ratio must be in (0, 1], got 2; for 2 % give 0.02"),
        ([], "one of --ratio, --faces, --max-error, --max-distance, --screen-error and --lods is needed"),
        (["--ratio", "0.5", "--faces", "9"], "--ratio 0.5 and --faces 9 exclude each other"),
        (["--lods", "0.5", "--flatten"], "--lods and --flatten exclude each other: "),
        (["--lods", "0.5", "--ratio", "0.5"], "--lods and --ratio exclude each other: the ratios of the levels"),
        (["--lods", "0.2,0.5"], "--lods: ratio 0.5 after 0.2"),
        (["--ratio", "0.5", "--usd-lod"], "--usd-lod needs --lods: the ratios"),
        (
            ["--ratio", "0.5", "--joints", "4", "--bake"],
            "--joints and --joint-error exclude --bake, --pose-independent",
        ),
        (["--ratio", "0.5", "--face-weight", "3"], "--face-weight: needs --metric 'face', not 'dsd'"),
        (["--ratio", "0.5", "--uv-weight", "-3"], "--uv-weight must be in [0, 1e+06], got -3"),
        (["--ratio", "0.5", "--memory", "much"], "--memory 'much': expected bytes"),
        (["--ratio", "0.5", "--attribute-weight", "x"], "--attribute-weight 'x': expected NAME=WEIGHT"),
        (["--ratio", "0.5", "--attribute-weight", "x=2"], "--attribute-weight: none of the 1 meshes has a primvar x"),
        (["--ratio", "0.5", "--weight-primvar", "ratio"], "--weight-primvar: none of the 1 meshes has a primvar ratio"),
        (["--max-distance", "3parsec"], "--max-distance '3parsec': expected a length"),
        (["--screen-error", "1"], "--screen-error needs --distance"),
        (["--faces", "0"], "--faces 0: expected at least 1"),
        (["--max-error", "inf"], "--max-error must be a finite number above 0, got inf"),
        (["--max-error", "nan"], "--max-error must be a finite number above 0, got nan"),
        (["--max-error", "0"], "--max-error must be a finite number above 0, got 0"),
        (["--max-error", "-1"], "--max-error must be a finite number above 0, got -1"),
        (["--max-error", "much"], "--max-error must be a finite number above 0, got 'much'\n"),
        (["--max-error", ""], "--max-error must be a finite number above 0, got ''\n"),
        (
            ["--max-error", "1mm"],
            "--max-error must be a finite number above 0, got '1mm'; it is in % of the diagonal; "
            "for a length give --max-distance 1mm\n",
        ),
        (["--max-error", "1%"], "--max-error must be a finite number above 0, got '1%'; it is in % anyway: give 1\n"),
        (["--ratio", "10%"], "--ratio must be in (0, 1], got '10%'; give 0.1\n"),
        (["--ratio", "0,1"], "--ratio must be in (0, 1], got '0,1'; give 0.1\n"),
        (["--ratio", "1/10"], "--ratio must be in (0, 1], got '1/10'; give 0.1\n"),
        (["--ratio", "200%"], "--ratio must be in (0, 1], got '200%'\n"),
        (["--ratio", "150"], "--ratio must be in (0, 1], got 150\n"),
        (["--ratio", "0.5", "--coherence", "50"], "--coherence must be in [0, 1], got 50; for 50 % give 0.5\n"),
        (["--lods", "50,25"], "--lods: ratio 50: expected a share above 0 and below 1; for 50 % give 0.5\n"),
        (
            ["--lods", "50%,25%"],
            "--lods '50%,25%': '50%' is no number; expected ratios such as 0.5,0.25,0.1; give 0.5\n",
        ),
        (
            ["--faces", "12345678901234567890"],
            "--faces '12345678901234567890': expected a whole number, or a share of all faces such as 25%\n",
        ),
        (
            ["--faces", "1,000"],
            "--faces '1,000': expected a whole number, or a share of all faces such as 25%; give 1000\n",
        ),
        (
            ["--faces", "0.1"],
            "--faces '0.1': expected a whole number, or a share of all faces such as 25%; for that share give 10%\n",
        ),
        (["--faces", "inf"], "--faces 'inf': expected a whole number, or a share of all faces such as 25%\n"),
        (["--max-distance", "inf"], "--max-distance 'inf': expected a length, finite and above 0"),
        (["--ratio", "0.5", "--max-size-error", "nan"], "--max-size-error must be above 0, or inf, got nan\n"),
        (["--screen-error", "inf", "--distance", "1"], "--screen-error must be a finite number above 0, got inf\n"),
        (
            ["--screen-error", "2px", "--distance", "1"],
            "--screen-error must be a finite number above 0, got '2px'; give 2\n",
        ),
        (
            ["--screen-error", "2", "--distance", "1", "--fov", "45deg"],
            "--fov must be in (0, 180), got '45deg'; give 45\n",
        ),
        (["--ratio", "0.5", "--key-frames", "2.5"], "--key-frames must be a whole number at least 1, got '2.5'\n"),
        (
            ["--ratio", "0.5", "--key-frames", "16.0"],
            "--key-frames must be a whole number at least 1, got '16.0'; give 16\n",
        ),
        (["--ratio", "0.5", "--joints", "inf"], "--joints 'inf': expected a whole number, or one for each level"),
        (["--ratio", "0.5", "--frames", "a:b"], "--frames: frame range 'a:b': START, END and STEP must be numbers\n"),
        (["--ratio", "0.5", "--report", "page.txt"], "--report page.txt: the suffix must be .html"),
    ],
)
def test_wrong_usage_names_flags(tmp_path, options, message):
    cloth_stage(tmp_path / "in.usda")
    done = run("simplify", tmp_path / "in.usda", "-o", tmp_path / "out.usda", *options)
    assert done.exit_code == 2
    assert done.stderr.startswith(f"error: {message}")
    assert "`" not in done.stderr


def test_each_command_has_its_own_flags(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    for arguments, message in (
        (("progressive", "extract", "none.wpqm", "-o", "out.usda"), "exactly one of --ratio, --faces, --max-error"),
        (("render", tmp_path / "in.usda", "-o", tmp_path / "out.png", "--heatmap"), "--heatmap needs a --reference"),
        (
            ("batch", tmp_path / "in.usda", "-o", tmp_path / "out", "--ratio", "1", "--jobs", "0"),
            "--jobs must be a whole number at least 1, got 0",
        ),
    ):
        assert run(*arguments).stderr.startswith(f"error: {message}"), arguments


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["render", "in.usda", "-o", "out.png", "--azimuth", "30deg"],
            "--azimuth must be a finite number, got '30deg'; give 30",
        ),
        (["render", "in.usda", "-o", "out.png", "--elevation", "nan"], "--elevation must be a finite number, got nan"),
        (
            ["render", "in.usda", "-o", "out.png", "--pictures", "0"],
            "--pictures must be a whole number at least 1, got 0",
        ),
        (
            ["compare", "in.usda", "in.usda", "--samples", "1e3"],
            "--samples must be a whole number at least 1, got '1e3'; give 1000",
        ),
        (["compare", "in.usda", "in.usda", "--scale", "inf"], "--scale must be a finite number above 0, got inf"),
        (["view", "in.usda", "--port", "99999"], "--port must be a whole number in [0, 65535], got 99999"),
        (
            ["simplify", "a.ply", "-o", "o.usda", "--ratio", "1", "--fps", "0"],
            "--fps must be a finite number above 0, got 0",
        ),
        (["batch", "in.usda", "-o", "out", "--jobs", "two"], "--jobs must be a whole number at least 1, got 'two'"),
        (["batch", "in.usda", "-o", "out", "--timeout", "inf"], "--timeout must be a finite number above 0, got inf"),
        (
            ["batch", "in.usda", "-o", "out", "--timeout", "9s"],
            "--timeout must be a finite number above 0, got '9s'; give 9",
        ),
        (["batch", "in.usda", "-o", "out", "--retries", "-1"], "--retries must be a whole number at least 0, got -1"),
        (["batch", "in.usda", "-o", "out", "--cpus", "nan"], "--cpus must be a finite number above 0, got nan"),
        (["batch", "in.usda", "-o", "out", "--gpus", "-1"], "--gpus must be a finite number at least 0, got -1"),
        (["face", "simplify", "in.usda", "-o", "o.usda", "--weight", "0.5"], "--weight must be in [1, 1e+12], got 0.5"),
        (
            ["face", "simplify", "in.usda", "-o", "o.usda", "--ring", "x"],
            "--ring must be a whole number at least 0, got 'x'",
        ),
        (
            ["features", "in.usda", "-o", "o.usda", "--feature-floor", "x"],
            "--feature-floor must be in [0, 180], got 'x'",
        ),
        (
            ["features", "in.usda", "-o", "o.usda", "--feature-threshold", "200"],
            "--feature-threshold must be in [0, 180], got 200",
        ),
        (
            ["progressive", "extract", "a.wpqm", "-o", "o.usda", "--faces", "10%"],
            "--faces must be a whole number at least 1, got '10%'; for a share give --ratio 0.1",
        ),
        (
            ["progressive", "extract", "a.wpqm", "-o", "o.usda", "--max-error", "1mm"],
            "--max-error must be a finite number above 0, got '1mm'; it is in % of the diagonal",
        ),
        (
            ["progressive", "build", "in.usda", "-o", "o.wpqm", "--base-faces", "x"],
            "--base-faces must be a whole number at least 1, got 'x'",
        ),
    ],
)
def test_numbers_of_every_command_name_flag_range_and_value(tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    cloth_stage(tmp_path / "in.usda")
    done = run(*arguments)
    assert done.exit_code == 2
    assert done.stderr.removesuffix(" (see warpqem --help)\n").removesuffix("\n") == f"error: {message}"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["simplify", "", "-o", "o.usda", "--ratio", "0.5"], "IN: the name is empty"),
        (["simplify", "in.usda", "-o", "", "--ratio", "0.5"], "--output: the name is empty"),
        (["simplify", "in.usda", "-o", "o.usda", "--ratio", "0.5", "--json", ""], "--json: the name is empty"),
        (["simplify", "in.usda", "-o", "o.usda", "--ratio", "0.5", "--poses", ""], "--poses: the name is empty"),
        (["batch", "", "-o", "out", "--ratio", "0.5"], "INPUT...: the name is empty"),
        (["batch", "in.usda", "-o", "", "--ratio", "0.5"], "--output: the name is empty"),
        (["compare", "in.usda", ""], "TEST: the name is empty"),
        (["info", ""], "IN: the name is empty"),
        (
            ["render", "in.usda", "-o", "o.png", "--size", "90000x90000"],
            "--size: 4 pictures of 90000 x 90000 pixels are",
        ),
    ],
)
def test_empty_names_and_pictures_beyond_all_memory_are_wrong_usage(tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    cloth_stage(tmp_path / "in.usda")
    done = run(*arguments)
    assert done.exit_code == 2
    assert done.stderr.startswith(f"error: {message}")
    assert [path.name for path in tmp_path.iterdir()] == ["in.usda"]


def test_an_empty_name_stands_for_no_folder_in_python(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cloth_stage(tmp_path / "in.usda")
    with pytest.raises(OptionError, match="an empty name: no such file"):
        find_files([""])
    with pytest.raises(StageError, match="the name of the file to read is empty"):
        inspect_stage("")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"ratio": 10}, "ratio must be in (0, 1], got 10; for 10 % give 0.1"),
        ({"ratio": "10%"}, "ratio must be in (0, 1], got '10%' (str); give 0.1"),
        ({"target_faces": 0.1}, "target_faces must be a whole number at least 1, got 0.1; for a share give ratio 0.1"),
        (
            {"target_faces": "10%"},
            "target_faces must be a whole number at least 1, got '10%' (str); for a share give ratio 0.1",
        ),
        ({"max_error": np.inf}, "max_error must be a finite number above 0, got inf"),
        (
            {"max_error": "1mm"},
            "max_error must be a finite number above 0, got '1mm' (str); it is in % of the diagonal; "
            "for a length give max_distance 1mm",
        ),
        ({"max_distance": np.nan}, "max_distance must be a finite number above 0, got nan"),
        ({"ratio": True}, "ratio must be in (0, 1], got True (bool)"),
    ],
)
def test_python_gets_the_same_hints(options, message):
    with pytest.raises(OptionError, match=f"^{re.escape(message)}$"):
        warpqem.simplify(*meshes.icosphere(1), **options)


def test_hints_are_numbers_that_are_taken():
    for text in ("10%", "0,1", "1/10", "10"):
        with pytest.raises(OptionError) as raised:
            read_options({"ratio": text})
        assert read_options({"ratio": re.search("give ([0-9.]+)", str(raised.value))[1]}).ratio == 0.1


def test_python_names_arguments_and_errors_survive_a_pipe():
    with pytest.raises(OptionError, match=r"^one of ratio, faces, max_error, max_distance, screen and lods is needed$"):
        SimplifyOptions()
    error = pickle.loads(pickle.dumps(OptionError("`lods` and `ratio` exclude each other")))
    assert str(error) == "lods and ratio exclude each other"
    assert error_text(error, FLAGS) == "--lods and --ratio exclude each other"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("nothing could be removed within max_error 0.1 %", "nothing could be removed within --max-error 0.1 %"),
        ("/a/max_error: broken", "/a/max_error: broken"),
        ("a.max_error 'max_error' primvars:max_error=1", "a.max_error 'max_error' primvars:max_error=1"),
        ("max_size_error", "--max-size-error"),
        ("5 faces, ratio 2", "5 faces, ratio 2"),
        ("no_such_name", "no_such_name"),
    ],
)
def test_names_of_several_words_become_flags_where_they_are_no_part_of_something_else(text, shown):
    assert with_flags(text, FLAGS) == shown
    assert error_text(StageError(text), FLAGS) == shown


def test_only_the_first_word_of_a_message_is_an_option_without_a_mark():
    assert error_text(OptionError("faces 0: faces must be more"), FLAGS) == "--faces 0: faces must be more"
    assert error_text(OptionError("there are 5 faces"), FLAGS) == "there are 5 faces"
