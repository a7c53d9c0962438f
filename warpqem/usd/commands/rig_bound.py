"""Limits on the distance of meshes with fewer influences, joints and blend shapes: as few as the limit leaves."""

from __future__ import annotations

from collections.abc import Callable

from warpqem.pipeline.result import SimplifiedMesh
from warpqem.usd.commands.rig_steps import Place, Rig, RigSteps
from warpqem.usd.commands.skin_bound import MAX_STEPS, STEP, Attempt

__all__ = ["fewest_of_rig", "fewest_steps", "simplify_with_fewer"]

# An RMS distance, added by joints or shapes that went, of more than this part of a limit has points that are beyond all
# of it.
HOPELESS_RMS = 0.5
# The step whose share leaves half of the limit to the rig, where no mesh holds it with what is asked for.
HALF_STEP = 2


def fewest_of_rig(mesh: SimplifiedMesh, steps: RigSteps, limit: float, holds: Callable[[Rig], bool]) -> Attempt:
    """The rig of as little as a limit leaves.

    Args:
        mesh: the simplified mesh.
        steps: its rigs.
        limit: the limit, in parts of the diagonal.
        holds: whether a rig holds the limit.
    """
    place = fewest_steps(steps.sizes, lambda place: holds(steps.at(place)))
    if place == (0, 0, 0):
        return Attempt(mesh, steps.at(place))
    hopeless = steps.at((0, 0, 0)).added_error > HOPELESS_RMS * 100.0 * limit
    if place is None:
        return Attempt(mesh, steps.at(steps.last), holds=False, place=steps.last, hopeless=hopeless)
    return Attempt(mesh, steps.at(place), place=place, hopeless=hopeless)


def fewest_steps(sizes: Place, holds: Callable[[Place], bool]) -> Place | None:
    """The smallest steps of several things with which a limit holds; None where it does not with the largest.

    All are taken back by as many parts of their ways, then each goes on alone as far as the others leave it.

    Args:
        sizes: steps of each.
        holds: whether the limit holds at a step of each; more of one never breaks it.
    """
    most: Place = (sizes[0] - 1, sizes[1] - 1, sizes[2] - 1)
    if holds((0, 0, 0)):
        return 0, 0, 0
    longest = max(most)
    if longest == 0 or not holds(most):
        return None

    def part(step: int) -> Place:
        first, second, third = (-(-step * size // longest) for size in most)
        return first, second, third

    place = part(_least(0, longest, lambda step: holds(part(step))))
    if sum(size > 0 for size in most) == 1:
        return place
    for index, step in enumerate(place):
        place = _with(place, index, _alone(place, index, step, holds))
    return place


def _alone(place: Place, index: int, high: int, holds: Callable[[Place], bool]) -> int:
    """The smallest step of one of the three with which a limit holds, the others given."""
    return _least(-1, high, lambda step: holds(_with(place, index, step)))


def _with(place: Place, index: int, step: int) -> Place:
    """A place with another step of one of the three."""
    first, second, third = (step if other == index else each for other, each in enumerate(place))
    return first, second, third


def _least(low: int, high: int, holds: Callable[[int], bool]) -> int:
    """The smallest step above one that does not hold up to one that does, by bisection."""
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high


def simplify_with_fewer(
    simplify: Callable[[float], SimplifiedMesh], attempt: Callable[[SimplifiedMesh], Attempt]
) -> Attempt:
    """Simplify by a share of a limit with which the rig of little holds the whole.

    Where no share is small enough for what is asked for, more stays.

    Args:
        simplify: gets the share.
        attempt: finds the rig of a result.
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
        return at(_least(0, last, lambda step: at(step).reached))
    for step in range(HALF_STEP, MAX_STEPS):
        if at(step).holds:
            # As little on a mesh of fewer faces is better.
            fewer = all(a <= b for a, b in zip(at(0).rig.counts, at(step).rig.counts, strict=True))
            return at(0) if at(0).holds and fewer else at(step)
    return at(last)
