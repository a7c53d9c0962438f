"""Text of files never drives what shows it: a terminal, a log, a page."""

from __future__ import annotations

import io
import json
import logging
import os
import re
import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from tests.support.cli import run
from tests.support.usd_stages import cloth_stage
from warpqem.batching.engine import Finished, Progressed, Started
from warpqem.batching.job_result import BatchResult
from warpqem.batching.jobs import BatchJob
from warpqem.cli.batch_display import BatchDisplay, dry_run_table, summary_table
from warpqem.cli.console import print_message
from warpqem.cli.logs import start_logging
from warpqem.cli.tables import PlainTable
from warpqem.printable import printable, printable_lines
from warpqem.report.overview import Asset, overview_page
from warpqem.report.page import page_json
from warpqem.usd import SimplifyOptions

NASTY = [
    "\x1b[31mred\x1b]0;title\x07",
    "two\nlines\r",
    "\u202egpj.exe",
    "[red]markup[/red] [/] [link=x]",
    "</script><script>alert(1)</script>",
    "bytes \udcff\udc80",
    "\x9b31m\x85\u2028",
    "back\\[",
]


def drives(text: str) -> list[str]:
    """The characters of a text that do something to what shows it, but for the breaks between lines."""
    return [one for one in text.replace("\n", "") if unicodedata.category(one) in ("Cc", "Cs", "Zl", "Zp", "Cf")]


@given(st.text(st.characters()))
def test_what_is_shown_stays_on_its_line_and_is_text(text):
    shown = printable(text)
    assert not set(drives(shown)) - {"\u200c", "\u200d"}
    assert "\n" not in shown
    shown.encode("utf-8")


@pytest.mark.parametrize("text", ["/Root/Cloth", "Ünïcode 日本\u3000語", "می\u200cخواهم", "[red]", "a\\b"])
def test_text_that_is_safe_stays_as_it_is(text):
    assert printable(text) == text


@pytest.mark.parametrize(
    ("text", "shown"),
    [("\x1b[1m", r"\x1b[1m"), ("a\nb\r", r"a\nb\r"), ("\u202e", r"\u202e"), ("\udcff", r"\xff"), ("\ud800", r"\ud800")],
)
def test_escapes_are_those_of_python(text, shown):
    assert printable(text) == shown


def test_lines_stay_lines():
    assert printable_lines("a\x1b\nb\r") == "a\\x1b\nb\\r"


@pytest.mark.parametrize("name", NASTY)
def test_terminal_gets_names_as_plain_text(name, capsys):
    print_message("error", f"{name}: wrong")
    assert drives(capsys.readouterr().err) == []
    job = BatchJob(name, f"/out/{name}", SimplifyOptions(ratio=0.5))
    plain = PlainTable(name)
    plain.add_column("mesh")
    plain.add_row(name)
    results = [BatchResult(name, name, "failed", error="StageError", message=name)]
    for table in (plain, dry_run_table([job], None), summary_table(results, 1, 1.0)):
        console = Console(file=io.StringIO(), width=300)
        console.print(table.rendered())
        assert drives(console.file.getvalue()) == []
        if table is plain:
            assert console.file.getvalue().count(printable(name)) == 2


@pytest.mark.parametrize("name", NASTY)
def test_progress_of_a_batch_shows_names_as_plain_text(name, monkeypatch):
    file = io.StringIO()
    terminal = Console(file=file, width=200, force_terminal=True, color_system=None)
    monkeypatch.setattr("warpqem.cli.batch_display.Console", lambda stderr: terminal)
    job = BatchJob(name, f"/out/{os.path.basename(name)}", SimplifyOptions(ratio=0.5))
    with BatchDisplay([job]) as display:
        display.update(Started(job))
        display.update(Progressed(job, 0.5, f"/{name}"))
        display._progress.refresh()
        display.update(Finished(job, BatchResult(name, job.output, "done")))
    # The bar itself moves the cursor; nothing else does.
    assert drives(re.sub(r"\x1b\[[?0-9;]*[A-Za-z]|\r", "", file.getvalue())) == []
    assert printable(os.path.basename(job.output)) in file.getvalue()


@pytest.mark.parametrize("name", NASTY)
def test_logs_show_names_as_plain_text_and_json_stays_json(name, tmp_path, capsys):
    start_logging(1, str(tmp_path / "log"))
    try:
        logging.getLogger("warpqem.test").warning("%s: begun", name)
        try:
            raise ValueError(name)
        except ValueError:
            logging.getLogger("warpqem.test").exception("failed")
    finally:
        for handler in logging.getLogger("warpqem").handlers[:]:
            handler.close()
            logging.getLogger("warpqem").removeHandler(handler)
    assert drives(capsys.readouterr().err) == []
    records = [json.loads(line) for line in (tmp_path / "log").read_text().splitlines()]
    assert records[0]["message"] == f"{name}: begun"
    assert "ValueError" in records[1]["traceback"]


@pytest.mark.parametrize("name", NASTY)
def test_pages_hold_names_as_text(name):
    page = overview_page(name, [Asset(name, "failed", message=name)], [name])
    assert drives(page) == []
    assert page.lower().count("</script") == 2
    page.encode("utf-8")
    assert json.loads(page_json({name: [name, (name, 1.0, None)]})) == {
        printable(name): [printable(name), [printable(name), 1.0, None]]
    }


@pytest.mark.parametrize("name", NASTY)
@pytest.mark.parametrize("place", ["command", "option", "value", "prim", "output"])
def test_usage_errors_quote_what_was_given_as_plain_text(name, place, tmp_path):
    cloth_stage(tmp_path / "in.usda")
    arguments = {
        "command": [name],
        "option": ["simplify", tmp_path / "in.usda", f"--{name}"],
        "value": ["simplify", tmp_path / "in.usda", "-o", "x.usda", "--ratio", name],
        "prim": ["simplify", tmp_path / "in.usda", "-o", tmp_path / "x.usda", "--ratio", 0.5, "--prim", f"/{name}"],
        "output": ["simplify", tmp_path / "in.usda", "-o", tmp_path / name / "x", "--ratio", 0.5],
    }[place]
    result = run(*arguments)
    assert result.exit_code in (1, 2)
    assert result.stderr.startswith("error: ")
    assert drives(result.stderr) == []


@pytest.mark.skipif(os.name != "posix", reason="names of files are text there")
def test_name_that_is_not_utf8_is_a_named_error(tmp_path):
    path = os.fsencode(tmp_path) + b"/\xff.usda"
    with open(path, "w") as file:
        file.write("#usda 1.0\n")
    result = run("info", os.fsdecode(path))
    assert (result.exit_code, result.stderr.splitlines()) == (
        1,
        [f"error: {tmp_path}/\\xff.usda: USD reads no file whose name is not UTF-8"],
    )
