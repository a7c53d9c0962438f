"""Roots of one level after another are those that all their collapses give."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.support import meshes
from warpqem import simplify
from warpqem.decimation.forest_cut import CollapseForest, Cut, last_collapses
from warpqem.decimation.level_roots import LevelRoots, RootCounts
from warpqem.decimation.pruning import DropRecord

POINTS, FACES = meshes.grid(14, 14)
COUNT = len(POINTS)


@pytest.fixture(scope="module")
def log():
    return simplify(POINTS[None].astype(np.float32), FACES, target_faces=20, quality="fast", device="cpu").log


def cuts(log):
    """Prefixes of a log without some collapses, and without what needs these."""
    forest, rng = CollapseForest(log, DropRecord.none(COUNT), COUNT), np.random.default_rng(3)
    none = np.empty(0, dtype=np.int64)
    for left_out in (0, 1, 5, 2, 0, 30):
        kept = np.arange(len(log)) < len(log) - rng.integers(0, 40)
        yield forest, forest.without(Cut(kept, np.zeros(0, dtype=bool)), rng.integers(0, len(log), left_out), none)


def test_roots_of_levels_are_those_of_their_collapses(log):
    roots = LevelRoots(SimpleNamespace(log=log, root=log.roots(COUNT)))
    for _, cut in cuts(log):
        before = roots.root.copy()
        changed, had = roots.at(cut.kept)
        np.testing.assert_array_equal(roots.root, log.chosen(cut.kept).roots(COUNT))
        np.testing.assert_array_equal(roots.index, roots.root)
        np.testing.assert_array_equal(changed, np.flatnonzero(roots.root != before))
        np.testing.assert_array_equal(had, before[changed])
        assert roots.root.dtype == np.int32


def test_counts_of_roots_follow_the_levels(log):
    valence = np.bincount(FACES.ravel(), minlength=COUNT)
    start = np.concatenate([[0], np.cumsum(valence)]).astype(np.int32)
    ordered = SimpleNamespace(log=log, root=log.roots(COUNT))
    counts = RootCounts(ordered.root, lambda: start)
    roots = LevelRoots(ordered, counts)
    for place, (_, cut) in enumerate(cuts(log)):
        roots.at(cut.kept)
        # Several changes may come before somebody asks.
        if place % 2:
            kept = np.unique(roots.root)
            size, corners = counts.of(kept)
            np.testing.assert_array_equal(size, np.bincount(roots.root)[kept])
            np.testing.assert_array_equal(corners, np.bincount(roots.root, valence)[kept])


def test_last_collapses_of_a_cut_are_the_last_of_those_kept(log):
    for forest, cut in cuts(log):
        np.testing.assert_array_equal(forest.last_collapses(cut), last_collapses(log, cut.kept, COUNT))


def test_faces_removed_by_a_cut_are_those_of_its_collapses(log):
    for forest, cut in cuts(log):
        assert forest.faces_removed(cut) == log.faces_removed[cut.kept].sum()


def test_collapses_chosen_later_have_the_values_of_those_chosen_now(log):
    for _, cut in cuts(log):
        later, now = log.chosen_later(cut.kept), log.chosen(cut.kept)
        for name, values in vars(now).items():
            np.testing.assert_array_equal(getattr(later, name), values)
        assert len(later) == len(now)
