"""A fit whose last corrections come along with what says to the host that they are final."""

from __future__ import annotations

from collections.abc import Callable, Generator

import numpy as np
import warp as wp

from warpqem.place.block_placer import PlacedFrames

__all__ = ["FitSteps", "FitUnderWay"]

# Yields numbers on the device for the host to read, and is sent them; returns whether the last ones changed nothing.
FitSteps = Generator[wp.array, np.ndarray, bool]


class FitUnderWay:
    """Corrections that are final unless numbers on the device say otherwise, which come along with what they moved.

    Args:
        apply: moves placed frames by the corrections as they are now.
        steps: goes on with them; None where they are final.

    Attributes:
        pending: (n,) int32 on the device, what the host is to read; None where the corrections are final.
    """

    def __init__(self, apply: Callable[[PlacedFrames], PlacedFrames], steps: FitSteps | None = None) -> None:
        self.apply, self._steps = apply, steps
        self.pending: wp.array | None = None if steps is None else next(steps)

    def stands(self, numbers: np.ndarray) -> bool:
        """Whether what was moved before is final, by what ``pending`` holds; else corrections are others now."""
        assert self._steps is not None
        try:
            self.pending = self._steps.send(numbers)
        except StopIteration as end:
            self.pending = None
            return bool(end.value)
        return False

    def complete(self) -> None:
        """Make the corrections final."""
        while self.pending is not None:
            self.stands(self.pending.numpy())
