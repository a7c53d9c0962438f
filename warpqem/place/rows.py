"""Compressed rows on the host: items grouped by cluster."""

from __future__ import annotations

import numpy as np

__all__ = ["group_rows", "sum_repeated"]


def group_rows(row: np.ndarray, row_count: int) -> tuple[np.ndarray, np.ndarray]:
    """Order that groups items by row, keeping their order within one, and where each row starts, (R+1,) int32."""
    order = np.argsort(row, kind="stable")
    start = np.zeros(row_count + 1, dtype=np.int32)
    np.cumsum(np.bincount(row, minlength=row_count), out=start[1:])
    return order, start


def sum_repeated(
    row: np.ndarray, item: np.ndarray, weight: np.ndarray, row_count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Items by row with the weights of repeated ones added.

    Args:
        row: (M,) int, the row of each entry; -1 for an entry to leave out.
        item: (M,) int.
        weight: (M,) float.
        row_count: rows R.

    Returns:
        ``start`` (R+1,) int32, ``item`` int32 ascending within a row, ``weight`` float32.
    """
    from scipy.sparse import coo_array  # here: commands that place nothing start without it

    if row.min(initial=0) < 0:
        inside = row >= 0
        row, item, weight = row[inside], item[inside], weight[inside]
    item_count = int(item.max(initial=-1)) + 1
    summed = coo_array((weight.astype(np.float64), (row, item)), shape=(row_count, item_count)).tocsr()
    summed.sum_duplicates()
    return summed.indptr.astype(np.int32), summed.indices.astype(np.int32), summed.data.astype(np.float32)
