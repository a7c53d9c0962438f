"""Folders and patterns of a batch: each file once, whatever links there are."""

from __future__ import annotations

import glob
import os
import string
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from warpqem.batching.input_search import match_pattern
from warpqem.batching.jobs import find_files

pytestmark = pytest.mark.skipif(os.name != "posix", reason="links and pipes")


def touch(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()


def names(*inputs: object, base: Path) -> list[str]:
    return [file.path.relative_to(base).as_posix() for file in find_files([str(one) for one in inputs])]


@pytest.fixture
def looped(tmp_path) -> Path:
    """Folders with links to themselves, to each other and to what is above them."""
    touch(tmp_path / "a/1.usda")
    touch(tmp_path / "a/b/2.usda")
    touch(tmp_path / "x/3.usd")
    (tmp_path / "a/self").symlink_to(".")
    (tmp_path / "a/b/up").symlink_to("../..")
    (tmp_path / "0first").symlink_to("a/b")
    (tmp_path / "x/again").symlink_to("../a")
    # Two links to the same folder at every level: 2 to the 40 ways, if each were gone.
    for index in range(6):
        (tmp_path / f"a/b/l{index}").symlink_to("../b")
    return tmp_path


@pytest.mark.parametrize("pattern", ["**/*.usd*", "**", "*/**", "**/**/*.usd*"])
def test_pattern_over_links_in_circles_ends_with_each_file_once(looped, pattern):
    found = find_files([str(looped / pattern)])
    assert sorted(os.path.realpath(file.path) for file in found) == [
        str(looped / name) for name in ("a/1.usda", "a/b/2.usda", "x/3.usd")
    ]


def test_file_is_named_by_the_way_without_links(looped):
    assert names(looped / "**/*.usd*", base=looped) == ["a/1.usda", "a/b/2.usda", "x/3.usd"]


def test_folder_that_only_a_link_leads_to_is_searched(tmp_path):
    touch(tmp_path / "elsewhere/1.usda")
    (tmp_path / "in").mkdir()
    (tmp_path / "in/link").symlink_to("../elsewhere")
    assert names(tmp_path / "in/**/*.usda", base=tmp_path) == ["in/link/1.usda"]


def test_links_to_a_file_are_that_file(tmp_path):
    touch(tmp_path / "b.usda")
    (tmp_path / "a.usda").symlink_to("b.usda")
    for inputs in (["*.usda"], ["a.usda", "b.usda"], ["."]):
        assert names(*(tmp_path / one for one in inputs), base=tmp_path) == ["b.usda"]


def test_hard_links_are_files_of_their_own(tmp_path):
    touch(tmp_path / "a.usda")
    os.link(tmp_path / "a.usda", tmp_path / "b.usda")
    assert names(tmp_path, base=tmp_path) == ["a.usda", "b.usda"]


def test_what_only_has_the_name_of_a_usd_file_is_found_to_be_named(tmp_path):
    touch(tmp_path / "a.usda")
    os.mkfifo(tmp_path / "pipe.usda")
    (tmp_path / "gone.usda").symlink_to("nowhere")
    (tmp_path / "round.usda").symlink_to("round.usda")
    expected = ["a.usda", "gone.usda", "pipe.usda", "round.usda"]
    assert names(tmp_path, base=tmp_path) == expected
    assert names(tmp_path / "*.usda", base=tmp_path) == expected
    assert names(tmp_path / "pipe.usda", base=tmp_path) == ["pipe.usda"]


def test_place_of_a_file_never_leads_out_of_the_outputs(tmp_path):
    touch(tmp_path / "x/1.usda")
    touch(tmp_path / "a/2.usda")
    [file] = find_files([str(tmp_path / "a/**/../x/*.usda")])
    assert file.relative == Path("1.usda")


PARTS = st.sampled_from(["a", "b", "*", "**", "?", "[ab]", ".c", "a*", ".*"])
PLACES = st.lists(st.sampled_from(["a", "b", ".c", "ab"]), min_size=1, max_size=4)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(parts=st.lists(PARTS, min_size=1, max_size=4), places=st.lists(PLACES, max_size=5), data=st.data())
def test_without_links_a_pattern_means_what_glob_makes_of_it(tmp_path, parts, places, data):
    root = tmp_path / data.draw(st.text(string.ascii_lowercase, min_size=12, max_size=12))
    root.mkdir(exist_ok=True)
    for place in places:
        (root / "/".join(place)).mkdir(parents=True, exist_ok=True)
        touch(root / "/".join(place) / "f.usda")
    pattern = str(root / "/".join(parts))
    # For a folder that is missing glob gives the name before "**" all the same.
    expected = {Path(path) for path in glob.glob(pattern, recursive=True) if os.path.exists(path)}
    assert set(match_pattern(pattern)) == expected
