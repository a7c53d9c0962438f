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
    one, other = (np.ascontiguousarray(end, dtype=np.intp) for end in edges.T)
    while True:
        # Those that have one root have the same one ever after.
        apart = np.flatnonzero(one != other)
        if not len(apart):
            return lowest
        one, other = one.take(apart), other.take(apart)
        # Only roots come to point lower, so that a tree's root is its lowest node.
        np.minimum.at(lowest, np.maximum(one, other), np.minimum(one, other))
        while True:
            jumped = lowest.take(lowest)
            if np.array_equal(jumped, lowest):
                break
            lowest = jumped
        one, other = lowest.take(one), lowest.take(other)
