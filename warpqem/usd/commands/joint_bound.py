"""Limits on the distance of skinned meshes with fewer joints: the limit holds, with as few joints as it leaves."""

from __future__ import annotations

from collections.abc import Callable

from warpqem.pipeline.result import SimplifiedMesh
from warpqem.usd.commands.skin_bound import MAX_STEPS, STEP, Attempt
from warpqem.usd.commands.skin_fit import FittedMesh

__all__ = ["fewest_joints", "simplify_with_fewer_joints"]

# An RMS distance, added by joints that went, of more than this part of a limit has points that are beyond all of it.
HOPELESS_RMS = 0.5
# The step whose share leaves half of the limit to the skin, where no mesh holds it with the joints that are asked for.
HALF_STEP = 2


def fewest_joints(
    mesh: SimplifiedMesh, steps: list[FittedMesh], limit: float, holds: Callable[[FittedMesh], bool]
) -> Attempt:
    """The skin of the fewest joints with which a limit holds, by bisection.

    Args:
        mesh: the simplified mesh.
        steps: its skins, of the fewest joints first.
        limit: the limit, in parts of the diagonal.
        holds: whether a skin holds the limit.
    """
    if holds(steps[0]):
        return Attempt(mesh, steps[0])
    few = steps[0].joints
    hopeless = few is not None and few.added_error > HOPELESS_RMS * 100.0 * limit
    low, high = 0, len(steps) - 1
    if high == 0 or not holds(steps[high]):
        return Attempt(mesh, steps[high], holds=False, reached=False, hopeless=hopeless)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if holds(steps[middle]) else (middle, high)
    return Attempt(mesh, steps[high], reached=False, hopeless=hopeless)


def simplify_with_fewer_joints(
    simplify: Callable[[float], SimplifiedMesh], attempt: Callable[[SimplifiedMesh], Attempt]
) -> Attempt:
    """Simplify by a share of a limit with which the skin of few joints holds the whole.

    Where no share is small enough for the joints that are asked for, more joints stay.

    Args:
        simplify: gets the share.
        attempt: finds the skin of a result.
    """
    tried: dict[int, Attempt] = {}

    def at(step: int) -> Attempt:
        if step not in tried:
            tried[step] = attempt(simplify(STEP**step))
        return tried[step]

    last = MAX_STEPS - 1
    if at(0).reached:
        return at(0)
    if not at(0).hopeless and at(last).reached:
        low, high = 0, last
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if at(middle).reached else (middle, high)
        return at(high)
    for step in range(HALF_STEP, MAX_STEPS):
        if at(step).holds:
            # As few joints on a mesh of fewer faces are better.
            return at(0) if at(0).holds and at(0).joint_count <= at(step).joint_count else at(step)
    return at(last)
