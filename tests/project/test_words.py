"""Names in code and help are terms of the field: words of the dialect that the project once had do not come back."""

import io
import re
import tokenize
from pathlib import Path

import pytest

from tests.support.cli import run

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("kernels", "warpqem", "tests", "benchmarks", "docs", "examples", "scenes")
FILES = sorted(p for folder in FOLDERS for p in (ROOT / folder).rglob("*.py") if "warpqem/kernels" not in p.as_posix())
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
COMMANDS = ("simplify", "batch", "info", "compare", "features", "render", "view", "face simplify", "progressive build")

# Costs are costly, collapses are checked, vertices lie opposite an edge, components are pruned, attributes transferred.
WORDS = r"dear(?:er|est)?|reprice[ds]?|judg(?:e[ds]?|ing)|gears?|wings?|vanish(?:e[ds]|ing)?|carriers?"
# Edges have costs, are selected, suspended and resumed; vertices are reserved, and have adjacent corners.
NAMES = rf"{WORDS}|prices?|priced|pricing|winners|claims?|stars|asleep|awake|sleeping"
CONSTANTS = r"(?:^|_)(?:MOST|LEAST)_|(?:^|_)(?:STARS?|PULL)(?:_|$)"
IN_NAMES = re.compile(rf"(?:^|_)(?:{NAMES})(?:_|$)|{CONSTANTS}")
# Launches come in groups: a phase is one of a wave.
REFUSED = {"Phase"}
# Seams are released, motion and attributes transferred, weights those of blend shapes.
IN_PROSE = re.compile(
    rf"\b(?:{WORDS}|carr(?:y|ies|ied|ying)|(?:let|lets) go|gives? way|morph weights)\b", re.IGNORECASE
)
IN_TEXT = re.compile(rf"\b(?:{WORDS})\b", re.IGNORECASE)


def refused(name) -> bool:
    """Whether a name holds one of the words; `EdgeJudge` counts as `edge_judge`."""
    spelt = name if name.isupper() else re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()
    return name in REFUSED or IN_NAMES.search(spelt) is not None


@pytest.mark.parametrize(
    "name",
    [
        "dearest",
        "reprice_all",
        "EdgeJudge",
        "gear",
        "left_wing",
        "_vanished",
        "MOST_NAMED",
        "price_edge",
        "EdgePrice",
        "commit_winners",
        "withdraw_claims",
        "STARS",
        "STAR_SLOTS",
        "keeping_stars",
        "SURFACE_PULL",
        "Phase",
        "only_awake",
    ],
)
def test_word_of_the_dialect_is_found_in_a_name(name):
    assert refused(name)


@pytest.mark.parametrize(
    "name",
    ["drawings", "swing", "most_common", "cost", "almost", "Carry", "starts", "star_polygon", "phase", "pull_back"],
)
def test_name_that_holds_one_by_chance_is_left_alone(name):
    assert not refused(name)


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_identifiers_are_terms_of_the_field(path):
    tokens = tokenize.generate_tokens(io.StringIO(path.read_text("utf-8")).readline)
    assert sorted(filter(refused, {t.string for t in tokens if t.type == tokenize.NAME})) == []


@pytest.mark.parametrize("command", COMMANDS)
def test_help_is_in_terms_of_the_field(command):
    shown = run(*command.split(), "--help-all")
    assert IN_TEXT.findall(shown.output) == []


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_pages_are_in_terms_of_the_field(page):
    assert IN_PROSE.findall(page.read_text("utf-8")) == []
