"""Walks along a profile of a face: to the next extremum, or to the point that stands out of a chord.

A profile is a curve of heights, evenly sampled; not a number where there is no surface. An extremum counts when the
profile turns back by some prominence, so noise of the mesh does not end a walk.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

__all__ = ["TILTS", "Stop", "from_chord", "walk_tilted", "walk_to_extremum"]


# Where nothing stands out straight forward, a profile is looked at from so many degrees above or below.
TILTS = (0.0, 10.0, 20.0)


class Stop(NamedTuple):
    """Where a walk ended: the sample, and by how much the point stands out, in the profile's unit."""

    at: int
    prominence: float


def walk_to_extremum(profile: np.ndarray, start: int, end: int, sign: float, prominence: float) -> Stop | None:
    """Walk from one sample towards another to the first local extremum.

    Args:
        profile: (n,) heights.
        start: sample to start from.
        end: last sample to look at, before or after it.
        sign: +1 for a maximum, -1 for a minimum.
        prominence: how far the profile must turn back, and must have come before, for an extremum to count.

    Returns:
        The extremum; None if the profile ends before it turns back.
    """
    step = 1 if end >= start else -1
    best = foot = start
    for at in range(start, end + step, step):
        height = sign * profile[at]
        if not np.isfinite(height):
            return None
        if height > sign * profile[best]:
            best = at
        elif sign * profile[best] - height > prominence:
            low, high = min(foot, best), max(foot, best)
            rise = sign * profile[best] - float((sign * profile[low : high + 1]).min())
            if rise >= prominence:
                return Stop(best, float(min(rise, _fall(profile, best, end, sign))))
            # The walk began on the far side of a slope: go on from where it has come to.
            best = foot = at
    return None


def walk_tilted(profile: np.ndarray, start: int, end: int, sign: float, prominence: float, step: float) -> Stop | None:
    """The same walk on the profile as it looks from ahead, the least tilt first that shows an extremum.

    Minima are looked for with what comes later on the way brought forward, maxima with it moved back; ``step`` is the
    distance between samples, in the unit of the heights.
    """
    way = np.abs(np.arange(len(profile)) - start) * step
    for tilt in np.radians(TILTS):
        seen = profile * np.cos(tilt) - sign * way * np.sin(tilt)
        stop = walk_to_extremum(seen, start, end, sign, prominence)
        if stop is not None:
            return stop
    return None


def _fall(profile: np.ndarray, best: int, end: int, sign: float) -> float:
    """How far the profile falls after an extremum before it rises above it again."""
    step = 1 if end >= best else -1
    lowest = top = sign * profile[best]
    for at in range(best, end + step, step):
        height = sign * profile[at]
        if not np.isfinite(height) or height > top:
            break
        lowest = min(lowest, height)
    return top - lowest


def from_chord(profile: np.ndarray, start: int, end: int, sign: float, step: float) -> Stop | None:
    """The point farthest from the chord between two samples.

    Args:
        profile: (n,) heights.
        start: one end of the chord.
        end: the other end.
        sign: +1 above the chord, -1 below it.
        step: distance between samples, in the unit of the heights.

    Returns:
        The point and its distance from the chord; None if nothing lies on that side, or the profile has a hole.
    """
    low, high = min(start, end), max(start, end)
    heights = profile[low : high + 1]
    if high - low < 2 or not np.isfinite(heights).all():
        return None
    run = (high - low) * step
    slope = (heights[-1] - heights[0]) / run
    chord = heights[0] + slope * step * np.arange(len(heights))
    distance = sign * (heights - chord) / np.hypot(1.0, slope)
    at = int(distance.argmax())
    return Stop(low + at, float(distance[at])) if distance[at] > 0.0 else None
