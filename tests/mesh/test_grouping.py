"""Items grouped by a whole number."""

import numpy as np
import pytest

from warpqem.mesh.grouping import different, faces_where, order_by, ranks


@pytest.mark.parametrize("count", [1, 7, 2**16, 2**16 + 1, 2**20, 2**32 + 1, 2**50])
def test_equal_numbers_stay_in_their_order(count):
    random = np.random.default_rng(1)
    number = np.append(random.integers(count, size=5000), [count - 1, 0])
    np.testing.assert_array_equal(order_by(number, count), np.argsort(number, kind="stable"))


@pytest.mark.parametrize("shape", [(0,), (1,), (5000,), (700, 3)])
def test_different_numbers_and_their_ranks_are_those_of_unique(shape):
    number = np.random.default_rng(2).integers(400, size=shape)
    unique, inverse = np.unique(number, return_inverse=True)
    np.testing.assert_array_equal(different(number, 400), unique)
    np.testing.assert_array_equal(ranks(number, 400), inverse.reshape(shape))


@pytest.mark.parametrize("count", [0, 1, 20000])
def test_faces_with_a_marked_corner_are_found(count):
    random = np.random.default_rng(3)
    faces, is_marked = random.integers(500, size=(count, 3)), random.random(500) < 0.1
    np.testing.assert_array_equal(faces_where(faces, is_marked.take), np.flatnonzero(is_marked[faces].any(axis=1)))
