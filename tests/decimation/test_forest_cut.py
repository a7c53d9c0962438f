"""Cuts through the forest of collapses, against a search that is as plain as can be."""

import numpy as np
import pytest

from tests.support.moving_meshes import MESHES
from warpqem.decimation.forest_cut import CollapseForest, Cut
from warpqem.options import read_keywords
from warpqem.pipeline.prepare import prepare


def ordered_mesh(name, device):
    points, faces = MESHES[name]
    work = prepare(points, faces, read_keywords({"target_faces": 60, "keep_components": True, "device": device}))
    return work.order()


def plain_cut(log, kept, vertex_count):
    """The largest cut within a choice: collapses go until each has its two clusters, and none joins what is apart."""
    kept = kept.copy()
    while True:
        root = np.arange(vertex_count)
        made_by = {}
        for c in range(len(log)):
            ends = log.kept[c], log.removed[c]
            needed = [made_by.get(v) for v in ends]
            if kept[c] and any(n is not None and not kept[n] for n in needed):
                kept[c] = False
            made_by[ends[0]] = c
            if kept[c]:
                root[root == ends[1]] = ends[0]
        joined = [
            c
            for c in np.flatnonzero(~kept)
            if log.opposites[c, 1] >= 0 and root[log.opposites[c, 0]] == root[log.opposites[c, 1]]
        ]
        if not joined:
            return kept
        for c in joined:
            kept[_joining(log, kept, *log.opposites[c])] = False


def _joining(log, kept, one, other):
    """The kept collapse after which two vertices are in one cluster."""
    for c in np.flatnonzero(kept):
        if log.removed[c] == one:
            one = log.kept[c]
        if log.removed[c] == other:
            other = log.kept[c]
        if one == other:
            return c
    raise AssertionError("they are apart")


@pytest.mark.parametrize("name", ["bar", "torus"])
def test_without_leaves_the_largest_cut(name, device):
    ordered = ordered_mesh(name, device)
    log, vertex_count = ordered.log, len(ordered.root)
    forest = CollapseForest(log, ordered.drops, vertex_count)
    rng = np.random.default_rng(3)
    none = np.empty(0, dtype=np.int64)
    for count in (1, 5, 40):
        prefix = np.arange(len(log)) < rng.integers(len(log) // 2, len(log))
        cut = Cut(prefix, np.zeros(len(ordered.drops), dtype=bool))
        left_out = rng.choice(np.flatnonzero(prefix), count)
        wanted = prefix.copy()
        wanted[left_out] = False
        np.testing.assert_array_equal(forest.without(cut, left_out, none).kept, plain_cut(log, wanted, vertex_count))


@pytest.mark.parametrize("name", ["bar", "torus"])
def test_what_is_left_out_step_by_step_is_left_out_of_every_beginning(name, device):
    ordered = ordered_mesh(name, device)
    log = ordered.log
    forest = CollapseForest(log, ordered.drops, len(ordered.root))
    rng, none = np.random.default_rng(4), np.empty(0, dtype=np.int64)
    left_out, chosen = np.zeros(len(log), dtype=bool), none
    for count in (1, 5, 20):
        newest = rng.choice(np.flatnonzero(~left_out), count, replace=False)
        forest.leave_out(left_out, newest)
        chosen = np.concatenate([chosen, newest])
        prefix = np.arange(len(log)) < rng.integers(len(log) // 2, len(log))
        cut = Cut(prefix, np.zeros(len(ordered.drops), dtype=bool))
        expected = forest.without(cut, chosen, none)
        np.testing.assert_array_equal(forest.without_all(cut, left_out).kept, expected.kept)


def test_within_leaves_the_largest_cut_of_small_errors(device):
    ordered = ordered_mesh("bar", device)
    log, vertex_count = ordered.log, len(ordered.root)
    forest = CollapseForest(log, ordered.drops, vertex_count)
    for error in np.quantile(log.error, [0.2, 0.6, 0.9]):
        expected = plain_cut(log, log.error <= error, vertex_count)
        np.testing.assert_array_equal(forest.within(error).kept, expected)
