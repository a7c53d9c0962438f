"""What USD says, without the names of its functions and source files."""

from __future__ import annotations

import re

import pytest
from pxr import Tf

from tests.support.cli import run
from warpqem.errors import StageError
from warpqem.usd.checks.usd_errors import UsdMessages
from warpqem.usd.read.open_stage import open_stage

CODE = re.compile(r"pxr|::|\.h\b|\.cpp|Error in|pegtl|template", re.IGNORECASE)


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ('def "x', "line 2, column 7"),
        ('def Xform "a" {\nfoo\n}\n', "line 3, column 1: Expected }"),
        ('def Xform "a" {\n point3f[] p = [(0,0]\n}\n', "line 3, column 21: syntax error at ']'"),
        ("(\n subLayers = [@a\n)", "line 3, column 17"),
        ("nonsense", "line 2, column 1: syntax error at 'nonsense'"),
        ('def Mesh "x" (\n references = </)\n{\n}\n', "line 3, column 17"),
        ('def "a" {\n}\ndef "a" {\n}\n', "line 4, column 5: Duplicate prim 'a'"),
        ('def "\x1b[31m" {\n}\n', "line 2, column 5: .*not a valid prim name"),
        ("(doc = 1" + "0" * 10_000 + ")", "line 2"),
    ],
)
def test_syntax_error_says_file_line_and_what(tmp_path, text, place):
    (tmp_path / "in.usda").write_text(f"#usda 1.0\n{text}")
    with pytest.raises(StageError) as raised:
        open_stage(tmp_path / "in.usda")
    message = str(raised.value)
    assert re.match(rf"{re.escape(str(tmp_path / 'in.usda'))}: USD cannot open it \({place}", message)
    assert not CODE.search(message)
    assert len(message) < 500


def test_syntax_error_in_another_file_names_it(tmp_path):
    (tmp_path / "bad.usda").write_text("#usda 1.0\nnonsense")
    (tmp_path / "in.usda").write_text("#usda 1.0\n(subLayers = [@./bad.usda@])\n")
    with pytest.raises(StageError, match=r"bad\.usda \(named by .*in\.usda\): USD cannot open it \(line 2, column 1"):
        open_stage(tmp_path / "in.usda")


def test_warnings_of_usd_are_kept_and_told_once(capfd):
    messages = UsdMessages()
    for _ in range(3):
        Tf.Warn("something\nis wrong")
    assert messages.take() == ["something", "is wrong"]
    assert messages.take() == []
    assert capfd.readouterr().err == ""


def test_command_tells_warnings_of_usd_in_its_own_way(tmp_path):
    (tmp_path / "in.usda").write_text('#usda 1.0\ndef "A" (\nreferences = @./gone.usda@\n)\n{\n}\n')
    result = run("info", tmp_path / "in.usda")
    assert result.exit_code == 0
    lines = [line for line in result.stderr.splitlines() if "gone.usda" in line]
    assert len(lines) == 1
    assert lines[0].startswith("note: ")
    assert not CODE.search(result.stderr)


def test_command_tells_nothing_that_was_warned_of_before_it(tmp_path, capfd):
    (tmp_path / "in.usda").write_text("#usda 1.0\n")
    run("info", tmp_path / "in.usda")
    Tf.Warn("between two commands")
    assert "between two commands" in capfd.readouterr().err  # USD's own way
    assert "between two commands" not in run("info", tmp_path / "in.usda").stderr
