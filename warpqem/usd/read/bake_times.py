"""When a skinned mesh is sampled that is written as points."""

from __future__ import annotations

import math
from collections.abc import Sequence

from pxr import Usd

from warpqem.errors import StageError
from warpqem.usd.read.time_codes import MAX_FRAMES

__all__ = ["bake_times"]


def bake_times(stage: Usd.Stage, times: Sequence[float]) -> list[float]:
    """The times at which `UsdSkel.BakeSkinning` writes points: those authored, and every frame of the stage in between.

    Joints turn between two keys, and points that only have samples at the keys cut the corner. Frames are counted from
    the stage's start time to the first one behind its end. A stage that does not say where it starts and ends has none.

    Args:
        stage: The stage.
        times: Times at which something that moves the points is authored, ascending.

    Raises:
        StageError: there are more frames than could be meant.
    """
    step = stage.GetTimeCodesPerSecond() / stage.GetFramesPerSecond()
    start, end = stage.GetStartTimeCode(), stage.GetEndTimeCode()
    if not times or not stage.HasAuthoredTimeCodeRange() or not start <= end < math.inf or not 0 < step < math.inf:
        return list(times)
    # Frames outside of the keys show what the nearest key does, so that none is looked for there.
    first = max(0, math.floor((times[0] - start) / step))
    last = min(math.floor((end - start) / step) + 1, math.ceil((times[-1] - start) / step))
    if last - first > MAX_FRAMES:
        name = stage.GetRootLayer().identifier
        raise StageError(f"{name}: {last - first} frames between the keys at {times[0]:g} and {times[-1]:g}")
    frames = (start + index * step for index in range(first, last + 1))
    return sorted({*times, *(frame for frame in frames if times[0] < frame < times[-1])})
