"""The fewest faces that hold a distance, of levels that only a whole run can make."""

from __future__ import annotations

import math
from collections.abc import Callable

from warpqem.arguments.distance_limit import DistanceLimit
from warpqem.arguments.progress import Progress
from warpqem.errors import OptionError
from warpqem.pipeline.prepare import ORDER_END
from warpqem.pipeline.result import SimplifiedMesh

__all__ = ["find_coarsest"]

# The search begins with steps of so many times the faces, and ends where it knows the count to so much.
FIRST_STEP = 1.5
LAST_STEP = 1.06


def find_coarsest(
    attempt: Callable[[int], SimplifiedMesh | None],
    face_count: int,
    *,
    start: int,
    least: int,
    limit: DistanceLimit,
    progress: Progress | None,
) -> SimplifiedMesh:
    """The level with the fewest faces that holds a distance, to some percent.

    Args:
        attempt: the level of so many faces; None where it does not hold.
        face_count: faces of the input.
        start: where to begin.
        least: the fewest faces to try.
        limit: the distance, for the message.
        progress: called after each level.

    Raises:
        OptionError: the input itself does not hold, as single precision does not place it so well.
    """
    good: SimplifiedMesh | None = None
    bad, count, left = 0, start, 1.0 - ORDER_END
    while True:
        found = attempt(count)
        # Each level takes about half of what is left.
        left /= 2
        if progress:
            progress(1.0 - left, "place")
        if found is not None:
            good = found
        elif count >= face_count:
            raise OptionError(f"{limit}: single precision does not place the input itself so well")
        else:
            bad = count
        if good is None:
            count = min(math.ceil(count * FIRST_STEP), face_count)
            continue
        reached_count = len(good.faces)
        if found is not None and reached_count > count:
            # No legal collapse leads further.
            return good
        if reached_count <= least or reached_count - bad <= 1:
            return good
        # The input itself is no answer as long as there may be another.
        if reached_count <= bad * LAST_STEP and reached_count < face_count:
            return good
        count = round(math.sqrt(reached_count * bad)) if bad else max(math.floor(reached_count / FIRST_STEP), least)
