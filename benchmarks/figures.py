"""Figures out of times: medians, ratios taken turn by turn, slopes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

__all__ = ["log_slope", "median", "ratio_in_turn"]


def median(values: Sequence[float]) -> float:
    """Median of at least one value."""
    return float(np.median(values))


def ratio_in_turn(times: Sequence[float], base: Sequence[float]) -> float:
    """Median over the turns of ``times[i] / base[i]``.

    The two were run one after the other in each turn, so what slows the machine for a while slows both, and their
    ratio drifts less than either time: the ratio of the medians would mix different moments.

    Raises:
        ValueError: no turn, or lists of different lengths.
    """
    if not len(base) or len(times) != len(base):
        raise ValueError(f"a ratio needs the same turns of both, got {len(times)} and {len(base)} times")
    return float(np.median(np.asarray(times, dtype=np.float64) / np.asarray(base, dtype=np.float64)))


def log_slope(work: Sequence[float], times: Sequence[float]) -> float | None:
    """Slope of log time over log work by least squares: 1 is linear. None below two different amounts of work."""
    x, y = np.log(np.asarray(work, dtype=np.float64)), np.log(np.asarray(times, dtype=np.float64))
    x = x - x.mean() if len(x) else x
    spread = float((x**2).sum())
    return float((x * y).sum()) / spread if spread > 0 else None
