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
    while True:
        # Both ends' roots take the lower of the two, then every node jumps to its root's root.
        roots = lowest[edges]
        after = lowest.copy()
        np.minimum.at(after, roots[:, 0], roots[:, 1])
        np.minimum.at(after, roots[:, 1], roots[:, 0])
        while True:
            jumped = after[after]
            if np.array_equal(jumped, after):
                break
            after = jumped
        if np.array_equal(after, lowest):
            return lowest
        lowest = after
