"""Rows of arrays by their numbers, some at a time."""

import numpy as np
import pytest

from warpqem.mesh.indexing import AT_ONCE, put_at, taken

COUNTS = [0, 5, AT_ONCE, AT_ONCE + 1, 3 * AT_ONCE + 7]


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("inner", [(), (3,)])
def test_rows_are_those_that_numpy_takes(count, inner):
    rng = np.random.default_rng(count)
    values = rng.random((1000, *inner)).astype(np.float32)
    index = rng.integers(0, len(values), count).astype(np.int32)
    found = taken(values, index)
    assert found.dtype == values.dtype
    np.testing.assert_array_equal(found, values[index])


def test_rows_have_the_shape_of_their_numbers():
    values, index = np.arange(10), np.random.default_rng(0).integers(0, 10, (AT_ONCE, 3))
    np.testing.assert_array_equal(taken(values, index), values[index])


@pytest.mark.parametrize("count", COUNTS)
def test_of_several_values_for_a_row_the_last_one_counts(count):
    index = np.random.default_rng(count).integers(0, 100, count).astype(np.int32)
    found, expected = (np.full(100, -1) for _ in range(2))
    put_at(found, index, np.arange(count))
    expected[index] = np.arange(count)
    np.testing.assert_array_equal(found, expected)


def test_one_value_goes_to_all_rows():
    found = np.zeros(AT_ONCE + 5, dtype=bool)
    put_at(found, np.arange(1, len(found), dtype=np.int32), True)
    assert found[1:].all()
    assert not found[0]


def test_a_row_that_is_not_there_is_an_error():
    with pytest.raises(IndexError):
        taken(np.zeros(3), np.full(AT_ONCE + 1, 3))
    with pytest.raises(IndexError):
        put_at(np.zeros(3), np.array([3]), 1.0)
