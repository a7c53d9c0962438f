"""The documentation as a site: it builds without a warning, fetches nothing, and has all commands and public names."""

from __future__ import annotations

import html
import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.docs import ROOT

pytest.importorskip("mkdocstrings", reason="the docs extra is not installed")
pytest.importorskip("material", reason="the docs extra is not installed")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    # In a process of its own, as it changes commands and loads what is otherwise loaded late.
    command = [sys.executable, "-m", "docs.site", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    # Neither a warning nor anything else but where it is.
    assert done.stderr == ""
    assert done.stdout.splitlines() == [str(folder / "index.html")]
    return folder


def read(page: Path) -> str:
    return page.read_text("utf-8")


def text_of(page: Path) -> str:
    """What a reader sees of a page."""
    return " ".join(html.unescape(re.sub(r"<[^>]+>", "", read(page))).split())


def test_no_page_fetches_anything_from_elsewhere(site):
    loads = re.compile(r"<(?:script|img|iframe|source|video)\b[^>]*\bsrc=\"([^\"]*)\"|<link\b[^>]*\bhref=\"([^\"]*)\"")
    for page in site.rglob("*.html"):
        loaded = ["".join(found) for found in loads.findall(read(page))]
        assert loaded
        assert [address for address in loaded if re.match(r"(?:https?:)?//", address)] == [], page.name
    for sheet in site.rglob("*.css"):
        assert not re.search(r"(?:@import|url\()\s*[\"']?(?:https?:)?//", read(sheet)), sheet.name


def test_every_page_of_the_checkout_is_on_the_site(site):
    for page in (ROOT / "docs").rglob("*.md"):
        name = page.relative_to(ROOT / "docs").with_suffix(".html").as_posix()
        assert (site / name.replace("README", "index")).exists(), name
    assert (site / "contributing.html").exists()


def test_links_lead_to_files_of_the_site(site):
    for page in site.rglob("*.html"):
        if page.name == "404.html":  # its links are those of a server's root
            continue
        for link in re.findall(r"<a\b[^>]*\bhref=\"([^\"#?]+)[^\"]*\"", read(page)):
            if not re.match(r"\w+:", link):
                assert (page.parent / link).resolve().exists(), f"{page.relative_to(site)}: {link}"


def test_all_public_names_are_in_the_reference_with_what_they_do(site):
    from docs.site.api_pages import MODULES, public_names

    for module in MODULES:
        page = read(site / "api" / f"{module}.html")
        for name in public_names(module):
            assert f'id="{module}.{name}"' in page, f"{module}.{name}"
            assert getattr(importlib.import_module(module), name).__doc__, f"{module}.{name}"
        assert not re.search(r":(?:mod|class|func):", page), module


def test_docstrings_link_to_the_public_names_that_they_mention(site):
    page = read(site / "api" / "warpqem.measure.html")
    compare = page[page.index('id="warpqem.measure.compare"') :]
    assert re.search(r'href="warpqem.html#warpqem.simplify"[^>]*><code[^>]*>warpqem.simplify</code>', compare)


def test_the_reference_shows_defaults_of_options_and_not_how_they_are_made(site):
    page = text_of(site / "api" / "warpqem.options.html")
    assert "ratio: float | None = None" in page
    assert "option(" not in page


def test_the_page_of_commands_has_every_option_with_its_full_help(site):
    from warpqem.arguments.option_fields import named_options
    from warpqem.usd.commands.simplify_options import SimplifyOptions

    page = text_of(site / "cli.html")
    simplify = page[page.index("warpqem simplify IN") : page.index("warpqem batch INPUT")]
    for name, entry in named_options(SimplifyOptions).items():
        assert f"--{name.replace('_', '-')} " in simplify, name
        assert " ".join(entry.option.help.replace("`", "").split()) in simplify, name


def test_the_page_of_commands_has_the_values_of_choices_and_defaults(site):
    page = text_of(site / "cli.html")
    found = re.search(r"--metric ((?:\w+ \| )+\w+) .*?Default: (\w+)\.", page)
    assert found is not None
    assert {"qem", "dsd", "dod", "aqem", "face"} <= set(found[1].split(" | "))
    assert found[2] == "dsd"


def test_options_stand_under_the_heads_of_the_help_in_its_order(site):
    page = text_of(site / "cli.html")
    simplify = page[page.index("warpqem simplify IN") : page.index("warpqem batch INPUT")]
    heads = ["Goal", "Quality", "What to keep", "Levels", "Output", "Machine"]
    places = [simplify.index(f" {head} option what it does") for head in heads]
    assert places == sorted(places)


def test_the_page_of_commands_has_every_command_and_its_examples(site):
    page = text_of(site / "cli.html")
    for name in ("batch", "info", "compare", "features", "render", "view", "progressive extract", "face retarget"):
        assert f"warpqem {name}" in page
    for name in ("simplify", "batch", "compare", "render", "view"):
        for example in importlib.import_module(f"warpqem.cli.{name}").EXAMPLES:
            assert example in page
