"""Connected components of a graph given by its edges."""

from __future__ import annotations

import numpy as np

__all__ = ["lowest_members"]


def lowest_members(node_count: int, edges: np.ndarray) -> np.ndarray:
    """The lowest node of each node's connected component.

    Args:
        node_count: nodes.
        edges: (E, 2) int.

    Returns:
        (node_count,) int.
    """
    lowest = np.arange(node_count)
    one, other = np.ascontiguousarray(edges.T, dtype=np.intp)
    while True:
        # Both ends' roots take the lower of the two, then every node jumps to its root's root.
        one, other = lowest.take(one), lowest.take(other)
        # Those that have one root have the same one ever after.
        apart = np.flatnonzero(one != other)
        one, other = one.take(apart), other.take(apart)
        after = lowest.copy()
        np.minimum.at(after, one, other)
        np.minimum.at(after, other, one)
        while True:
            jumped = after.take(after)
            if np.array_equal(jumped, after):
                break
            after = jumped
        if np.array_equal(after, lowest):
            return lowest
        lowest = after
