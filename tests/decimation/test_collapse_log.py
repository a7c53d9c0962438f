"""The collapse log, from the rows that threads left in any order within a round."""

from dataclasses import fields

import numpy as np
import pytest
import warp as wp
from hypothesis import given
from hypothesis import strategies as st

from warpqem.decimation.collapse_log import (
    RECENT,
    CollapseRecord,
    _order_by_sorts,
    _order_on_host,
    log_of,
    ordered_log,
    read_log,
)

VERTEX_COUNT = 300


def log_rows(seed, count, capacity=VERTEX_COUNT) -> np.ndarray:
    """(8, capacity) int32 rows of ``count`` collapses of independent vertices in rounds, with garbage behind them."""
    rng = np.random.default_rng(seed)
    rows = rng.integers(-(2**31), 2**31 - 1, size=(8, capacity)).astype(np.int32)
    vertex = rng.permutation(capacity)
    round_index = np.sort(rng.integers(1, 12, size=count))
    # A vertex goes into one that stays for longer than its round.
    after = np.searchsorted(round_index, round_index, side="right")
    kept = vertex[rng.integers(after, capacity)] if count else np.empty(0)
    opposites = rng.integers(0, capacity, size=count), rng.integers(-1, capacity, size=count)
    rows[:6, :count] = [kept, vertex[:count], *opposites, rng.integers(1, 3, size=count), round_index]
    # Many costs are equal.
    rows[6, :count] = rng.choice(np.float32([0.0, 1e-30, 0.5, 2.0]), size=count).view(np.int32)
    rows[7, :count] = rng.random(count).astype(np.float32).view(np.int32)
    return rows


def order_of(rows, count) -> np.ndarray:
    values = rows[:, :count]
    return np.lexsort((values[1], values[6].view(np.float32), values[5]))


@pytest.mark.parametrize("order", [_order_on_host, _order_by_sorts])
@pytest.mark.parametrize("count", [1, 2, 150, VERTEX_COUNT - 1])
def test_collapses_come_by_round_then_cost_then_removed_vertex(order, count, device):
    rows = log_rows(count, count)
    found = order(wp.array(rows, device=device), count).numpy()
    np.testing.assert_array_equal(found, order_of(rows, count))


@pytest.mark.parametrize("count", [1, 16, 17, 250])
def test_a_log_is_its_rows_in_order(count, device):
    rows = log_rows(7, count)
    log, expected = read_log(wp.array(rows, device=device), count), rows[:, order_of(rows, count)]
    for name, row in zip(("kept", "removed", "faces_removed", "round_index"), expected[[0, 1, 4, 5]], strict=True):
        np.testing.assert_array_equal(getattr(log, name), row)
    np.testing.assert_array_equal(log.opposites, expected[2:4].T)
    np.testing.assert_array_equal(log.cost, expected[6].view(np.float32))
    np.testing.assert_array_equal(log.error, np.sqrt(expected[7].view(np.float32)))
    squared = log.error.astype(np.float64) ** 2
    means = [squared[i - max(int(RECENT * i), 1) : i].mean() for i in range(1, count + 1)]
    np.testing.assert_allclose(log.recent_error, np.sqrt(means), rtol=1e-6)


@pytest.mark.parametrize("spare", [0, 3, 40])
@pytest.mark.parametrize("count", [0, 1, 17, 250])
def test_a_log_that_is_read_before_its_length_is_known_is_the_same(count, spare, device):
    rows = wp.array(log_rows(7, count), device=device)
    there = wp.array([count], dtype=wp.int32, device=device)
    log, expected = log_of(ordered_log(rows, there, count + spare).numpy(), count), read_log(rows, count)
    assert_same_log(log, expected)


@pytest.mark.parametrize("count", [1, 16, 250])
def test_recent_errors_of_some_collapses_are_those_of_all(count, device):
    log = read_log(wp.array(log_rows(7, count), device=device), count)
    index = np.arange(0, count, 3)
    found, kept = log.recent_errors_at(index), np.arange(count) % 2 == 0
    np.testing.assert_array_equal(found, log.recent_error[index])
    some = log.chosen_later(kept)
    places = np.arange(0, len(some), 2)
    np.testing.assert_array_equal(some.recent_errors_at(places), log.recent_error[kept][places])
    np.testing.assert_array_equal(log.made().recent_errors_at(index), found)


@pytest.mark.parametrize("count", [0, 1, 250])
def test_roots_of_a_log_as_it_was_read_are_those_of_its_values(count, device):
    log = read_log(wp.array(log_rows(7, count), device=device), count)
    np.testing.assert_array_equal(log.roots(VERTEX_COUNT), log.made().roots(VERTEX_COUNT))


def assert_same_log(log, expected):
    for field in fields(CollapseRecord):
        np.testing.assert_array_equal(getattr(log, field.name), getattr(expected, field.name))


def record_of(kept, recent) -> CollapseRecord:
    none = np.zeros(len(kept), dtype=np.int32)
    return CollapseRecord(np.array(kept, dtype=np.int32), none, none, none, none, none, none, np.float32(recent))


def test_a_vertex_has_the_recent_error_of_the_last_collapse_into_it():
    log = record_of([3, 1, 3], [0.1, 0.2, 0.4])
    np.testing.assert_array_equal(log.last_errors(np.array([1, 2, 3])), np.float32([0.2, 0.0, 0.4]))


def test_a_log_without_collapses_has_no_recent_errors():
    assert not record_of([], []).last_errors(np.arange(4)).any()


def test_a_log_without_collapses_is_empty(device):
    log = read_log(wp.array(log_rows(0, 0), device=device), 0)
    assert len(log) == len(log.recent_error) == 0
    assert log.opposites.shape == (0, 2)
    np.testing.assert_array_equal(log.roots(5), np.arange(5))


@given(st.integers(0, 2**32 - 1), st.integers(0, VERTEX_COUNT - 1), st.floats(0, 1))
def test_roots_are_where_following_the_collapses_ends(seed, count, share):
    rows = log_rows(seed, count)[:, :count]
    none = np.zeros(count, dtype=np.float32)
    log = CollapseRecord(rows[0], rows[1], rows[2:4].T, rows[4], none, none, rows[5], none)
    log = log.chosen(np.random.default_rng(seed).random(count) < share)
    into = dict(zip(log.removed.tolist(), log.kept.tolist(), strict=True))
    for vertex, root in enumerate(log.roots(VERTEX_COUNT).tolist()):
        while vertex in into:
            vertex = into[vertex]
        assert root == vertex
