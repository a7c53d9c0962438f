"""The documentation: its commands and its Python run, its links lead somewhere, its errors exist."""

from __future__ import annotations

import importlib
import json
import re
from pathlib import Path

import pytest
import warp
from PIL import Image

from docs.notebook import NOTEBOOK, run_cells
from tests.support.docs import ROOT, run_line
from warpqem.arguments.option_fields import named_options
from warpqem.cli.main import app
from warpqem.options import MeshOptions
from warpqem.usd import SimplifyOptions

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
GUIDES = ["start.md", "pipeline.md", "batch.md", "python.md", "cookbook.md", "appearance.md", "blender.md"]


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def blocks(page: Path) -> list[tuple[str, str]]:
    """Language and text of each fenced block of a page."""
    return re.findall(r"^```(\w+)\n(.*?)^```", page.read_text("utf-8"), re.S | re.M)


@pytest.mark.parametrize("guide", GUIDES)
def test_everything_in_a_guide_runs_in_its_order(desk, guide, capsys):
    found = blocks(ROOT / "docs" / guide)
    assert found
    # Continuous integration sets up the project with these.
    set_up = {text for language, text in blocks(ROOT / "README.md") if language == "sh"}
    names: dict[str, object] = {"__name__": guide}
    for language, text in found:
        if text in set_up:
            continue
        if language == "sh":
            for line in text.splitlines():
                run_line(line)
        elif language == "python":
            exec(compile(text, guide, "exec"), names)


def test_the_notebook_runs_in_its_order(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    notebook = json.loads(NOTEBOOK.read_text("utf-8"))
    cells = [cell for cell in run_cells(notebook)["cells"] if cell["cell_type"] == "code"]
    kept = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert len(cells) > 5
    # As it is kept: the same kinds of outputs, and the same text; pictures may differ between machines.
    for cell, before in zip(cells, kept, strict=True):
        assert [sorted(out.get("data", ["text"])) for out in cell["outputs"]] == [
            sorted(out.get("data", ["text"])) for out in before["outputs"]
        ]
    assert (tmp_path / "flag.usdc").exists()


def test_the_notebook_is_one_that_jupyter_reads():
    notebook = json.loads(NOTEBOOK.read_text("utf-8"))
    assert notebook["nbformat"] == 4
    for cell in notebook["cells"]:
        assert {"cell_type", "metadata", "source"} <= cell.keys()
        assert cell["cell_type"] == "markdown" or {"outputs", "execution_count"} <= cell.keys()
    assert NOTEBOOK.stat().st_size < 500_000


def test_no_page_has_a_command_that_no_test_runs():
    # Those of README and CONTRIBUTING set up the project, and continuous integration runs them word for word.
    with_commands = {name_of(page) for page in PAGES if any(language == "sh" for language, _ in blocks(page))}
    # Those of docs/install.md are run by tests/long/other_usd.py.
    assert with_commands <= {"README.md", "CONTRIBUTING.md", "docs/install.md", *(f"docs/{guide}" for guide in GUIDES)}
    own = [text for language, text in blocks(ROOT / "CONTRIBUTING.md") if language == "sh"]
    readme = [text for language, text in blocks(ROOT / "README.md") if language == "sh"]
    assert set(own) <= set(readme)


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_to_files_and_headings_that_exist(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text("utf-8")):
        if target.startswith("http"):
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        assert file.exists(), target
        if anchor:
            headings = re.findall(r"^#+ (.*)$", file.read_text("utf-8"), re.M)
            assert anchor in [re.sub(r"[^\w -]", "", heading).lower().replace(" ", "-") for heading in headings]


def test_errors_in_the_guide_are_those_of_the_code():
    source = "\n".join(path.read_text("utf-8") for path in (ROOT / "warpqem").rglob("*.py"))
    # As the code has it: adjacent pieces joined, values left open.
    code = re.sub(r"\{[^{}]*\}", "", re.sub(r'"\s*\n\s*f?"', "", source))
    # The command line writes flags for the names of options.
    code += re.sub(r"`([a-z_]+)`", lambda found: "--" + found[1].replace("_", "-"), code)
    rows = re.findall(r"^\| `([^`]+)` \|", (ROOT / "docs" / "errors.md").read_text("utf-8"), re.M)
    assert len(rows) > 15
    assert [row for row in rows if row not in code] == []


def test_every_option_on_the_pages_exists():
    import typer.main

    group = typer.main.get_command(app)
    commands = [
        group,
        *group.commands.values(),
        *(command for name in ("progressive", "face") for command in group.commands[name].commands.values()),
    ]
    options = [option for command in commands for option in command.params]
    known = {"--help", *(name for option in options for name in (*option.opts, *option.secondary_opts))}
    for page in PAGES:
        # Inside code of one line: other programs' options are not named like ours.
        for code in re.findall(r"`([^`\n]+)`", page.read_text("utf-8")):
            for option in re.findall(r"(?<![\w-])--[a-z][a-z-]+", code):
                if not code.startswith(("python -m", "ruff", "pip", ".venv")):
                    assert option in known, f"{name_of(page)}: {code}"


def test_pages_of_the_command_line_name_flags_and_those_of_python_keywords():
    names = {*named_options(SimplifyOptions), *named_options(MeshOptions)}
    # Those of one word are words of prose and of JSON, too.
    names = {name for name in names if "_" in name}
    for page in PAGES:
        text = re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.S | re.M)
        name = name_of(page)
        if name == "docs/python.md":
            wrong = [line for line in text.splitlines() if re.search(r"`--[a-z]", line) and "command" not in line]
        elif name.startswith(("docs/design/", "docs/papers.md", "docs/algorithm.md", "CONTRIBUTING.md")):
            continue  # about the code
        else:
            # A line about Python, or a table with a column for each.
            lines = [line for line in text.splitlines() if "Python" not in line and "`--" not in line]
            wrong = [line for line in lines if names & set(re.findall(r"`([a-z_]+)`", line))]
        assert wrong == [], name


def test_architectures_of_the_table_of_gpus_are_those_that_warp_compiles_for():
    known = set(warp.get_cuda_supported_archs())
    if not known:
        pytest.skip("this build of Warp compiles for no GPU")
    rows = re.findall(r"^\| (\d+(?:, \d+)*) \|", (ROOT / "docs" / "systems.md").read_text("utf-8"), re.M)
    assert {int(arch) for row in rows for arch in row.split(", ")} == known


def test_figures_are_those_that_the_program_draws():
    pytest.importorskip("skimage", reason="the scenes extra is not installed")
    figures = importlib.import_module("docs.figures")
    drawn = set(figures.FIGURES)
    there = {path.name for path in (ROOT / "docs").iterdir() if path.suffix in (".png", ".gif")}
    assert drawn == there


def test_pictures_are_small():
    for path in (ROOT / "docs").iterdir():
        if path.suffix in (".png", ".gif"):
            # A film of 60 frames with its texture is larger than a picture.
            assert path.stat().st_size < (800_000 if path.suffix == ".gif" else 500_000), path.name
            with Image.open(path) as picture:
                assert picture.width <= 1600
