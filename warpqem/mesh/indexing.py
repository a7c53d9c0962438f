"""Values of many items by their numbers, without large arrays on the way.

NumPy widens numbers of 32 bits that it is to index by, all at once, and new memory for that takes longer than the rest.
"""

from __future__ import annotations

import numpy as np

__all__ = ["AT_ONCE", "put_at", "taken"]

# Numbers that are widened at once: they stay in the cache.
AT_ONCE = 8192


def taken(values: np.ndarray, index: np.ndarray) -> np.ndarray:
    """What ``values[index]`` gives: rows of ``values`` (n, ...), one for each number in ``index``, of any shape.

    Raises:
        IndexError: there is no such row.
    """
    if index.size <= AT_ONCE:
        return values.take(index, axis=0)
    numbers = index if index.ndim == 1 else index.ravel()
    found = np.empty((len(numbers), *values.shape[1:]), dtype=values.dtype)
    for first in range(0, len(numbers), AT_ONCE):
        part = slice(first, first + AT_ONCE)
        found[part] = values.take(numbers[part], axis=0)
    return found.reshape(*index.shape, *values.shape[1:])


def put_at(values: np.ndarray, index: np.ndarray, put: np.ndarray | float) -> None:
    """What ``values[index] = put`` does, of rows ``index`` (n,) and one value for each or the same for all.

    Of several values for a row the last one counts.

    Raises:
        IndexError: there is no such row.
    """
    for first in range(0, len(index), AT_ONCE):
        part = slice(first, first + AT_ONCE)
        values[index[part].astype(np.intp)] = put[part] if isinstance(put, np.ndarray) else put
