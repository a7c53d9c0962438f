"""Items grouped by a whole number."""

import numpy as np
import pytest

from warpqem.mesh.grouping import order_by


@pytest.mark.parametrize("count", [1, 7, 2**16, 2**16 + 1, 2**20, 2**32 + 1, 2**50])
def test_equal_numbers_stay_in_their_order(count):
    random = np.random.default_rng(1)
    number = np.append(random.integers(count, size=5000), [count - 1, 0])
    np.testing.assert_array_equal(order_by(number, count), np.argsort(number, kind="stable"))
