"""Items grouped by a whole number that each has, and faces by what is so at their corners."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["any_corner", "order_by"]

# NumPy sorts numbers of so many bits by counting them.
COUNTED_BITS = 16


def any_corner(at_corner: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """(n,) bool, whether something is so at any corner of each face, of (n, 3); ``any`` takes ten times as long."""
    found: npt.NDArray[np.bool_] = at_corner[:, 0] | at_corner[:, 1]
    found |= at_corner[:, 2]
    return found


def order_by(number: npt.NDArray[np.integer], count: int) -> npt.NDArray[np.int64]:
    """The indices (n,) that bring numbers (n,) from 0 to below ``count`` in order, equal ones as they stand.

    What a stable ``argsort`` gives, in a tenth to a quarter of its time up to 2 ** 32 of them.
    """
    order = np.argsort(number.astype(np.uint16), kind="stable")
    shift = COUNTED_BITS
    while count > 1 << shift:
        digit = (number[order] >> shift).astype(np.uint16)
        order = order[np.argsort(digit, kind="stable")]
        shift += COUNTED_BITS
    return order
