"""Messages of the command line name flags; in Python the same errors name arguments."""

from __future__ import annotations

import pickle

import pytest

from tests.support.cli import run
from tests.support.usd_stages import cloth_stage
from warpqem.cli.flag_names import error_text, flags_of_options, with_flags
from warpqem.errors import OptionError, StageError
from warpqem.usd import SimplifyOptions

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
        (["--ratio", "0.5", "--uv-weight", "-3"], "--uv-weight must be in [0, 1e+06], got -3.0"),
        (["--ratio", "0.5", "--memory", "much"], "--memory 'much': expected bytes"),
        (["--ratio", "0.5", "--attribute-weight", "x"], "--attribute-weight 'x': expected NAME=WEIGHT"),
        (["--ratio", "0.5", "--attribute-weight", "x=2"], "--attribute-weight: none of the 1 meshes has a primvar x"),
        (["--ratio", "0.5", "--weight-primvar", "ratio"], "--weight-primvar: none of the 1 meshes has a primvar ratio"),
        (["--max-distance", "3parsec"], "--max-distance '3parsec': expected a length"),
        (["--screen-error", "1"], "--screen-error needs --distance"),
        (["--faces", "0"], "--faces 0: expected at least 1"),
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
        (("batch", tmp_path / "in.usda", "-o", tmp_path / "out", "--ratio", "1", "--jobs", "0"), "--jobs 0: expected"),
    ):
        assert run(*arguments).stderr.startswith(f"error: {message}"), arguments


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
