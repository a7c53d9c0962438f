"""Removal of joints from the leaves of the skeleton, as engines do by rule."""

from __future__ import annotations

import numpy as np

from warpqem.skinning.joint_removal import JointRemoval

__all__ = ["next_leaf"]


def next_leaf(
    removal: JointRemoval, parents: np.ndarray, may_go: np.ndarray | None = None, deepest: bool = True
) -> int | None:
    """The leaf that goes next, of several the one that costs least; None where none may go.

    Args:
        removal: the state of the removal.
        parents: (J,) the joint above each, -1 for none.
        may_go: (J,) bool; None for all.
        deepest: look at the deepest leaves only, not at all.
    """
    used = removal.used()
    above = {joint: _above(parents, joint) for joint in used.tolist()}
    inner = {joint for chain in above.values() for joint in chain}
    leaves = [joint for joint in above if joint not in inner and (may_go is None or may_go[joint])]
    if deepest:
        depth = max((len(above[joint]) for joint in leaves), default=0)
        leaves = [joint for joint in leaves if len(above[joint]) == depth]
    return min(leaves, key=removal.cost, default=None)


def _above(parents: np.ndarray, joint: int) -> list[int]:
    """All joints above one, of a skeleton without loops."""
    chain: list[int] = []
    while parents[joint] >= 0 and len(chain) < len(parents):
        joint = int(parents[joint])
        chain.append(joint)
    return chain
