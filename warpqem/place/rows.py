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
        row: (M,) int, the row of each entry.
        item: (M,) int.
        weight: (M,) float.
        row_count: rows R.

    Returns:
        ``start`` (R+1,) int32, ``item`` int32 ascending within a row, ``weight`` float32.
    """
    start = np.zeros(row_count + 1, dtype=np.int32)
    if len(row) == 0:
        return start, np.zeros(0, dtype=np.int32), np.zeros(0, dtype=np.float32)
    item_count = int(item.max()) + 1
    key = row.astype(np.int64) * item_count + item
    order = np.argsort(key)
    key = key[order]
    first = np.flatnonzero(np.append(True, key[1:] != key[:-1]))
    key = key[first]
    total = np.add.reduceat(weight[order].astype(np.float64), first)
    np.cumsum(np.bincount(key // item_count, minlength=row_count), out=start[1:])
    return start, (key % item_count).astype(np.int32), total.astype(np.float32)
