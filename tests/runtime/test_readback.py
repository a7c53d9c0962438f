"""Arrays that come to the host together."""

import numpy as np
import pytest
import warp as wp

from warpqem.runtime.readback import joined, read_together


def test_arrays_of_no_whole_words_are_refused(device):
    with pytest.raises(ValueError, match="arrays of 3, 4 bytes, expected words of 4"):
        joined([wp.zeros(3, dtype=wp.bool, device=device), wp.zeros(1, dtype=wp.int32, device=device)])


def test_arrays_that_are_joined_lie_one_after_the_other(device):
    parts = [wp.array(np.arange(3, dtype=np.int32), device=device), wp.zeros(0, dtype=wp.int32, device=device)]
    np.testing.assert_array_equal(joined([*parts, parts[0]]).numpy(), [0, 1, 2, 0, 1, 2])


def test_arrays_that_are_read_together_are_as_each_alone(device):
    rng = np.random.default_rng(0)
    given = [
        wp.array(rng.normal(size=(3, 5, 3)), dtype=wp.vec3, device=device),
        wp.array(np.arange(7), dtype=wp.int32, device=device),
        wp.empty(0, dtype=wp.float32, device=device),
        wp.array(rng.normal(size=3), dtype=wp.float64, device=device),
        wp.array(rng.normal(size=(2, 3, 3)), dtype=wp.mat33, device=device),
        wp.array(np.arange(8) % 3 == 0, dtype=wp.bool, device=device),
    ]
    for array, found in zip(given, read_together(*given), strict=True):
        assert found.dtype == array.numpy().dtype
        np.testing.assert_array_equal(found, array.numpy())
