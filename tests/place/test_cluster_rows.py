"""Items grouped by row."""

import numpy as np
import pytest

from warpqem.place.cluster_rows import group_rows


@pytest.mark.parametrize("row_count", [7, 1 << 16, (1 << 16) + 1, 300_000])
def test_items_are_grouped_by_row_in_their_order(row_count):
    row = np.random.default_rng(3).integers(0, row_count, 1000).astype(np.int32)
    row[:4] = row_count - 1, 0, row_count - 1, 0
    order, start = group_rows(row, row_count)
    assert (order == np.argsort(row, kind="stable")).all()
    assert (np.diff(start) == np.bincount(row, minlength=row_count)).all()
