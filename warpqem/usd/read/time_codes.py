"""Which time codes of an animation are read."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from warpqem.arguments.number_text import parse_number
from warpqem.errors import OptionError

__all__ = ["FrameRange"]

# A time counts as equal to the end of the range within this share of a step, so that 0:1:0.1 includes 1.
STEP_TOLERANCE = 1e-6

# More frames than this from one range is taken for a slip of the pen (an hour at 24 frames per second is 86400).
MAX_FRAMES = 1_000_000


@dataclass(frozen=True)
class FrameRange:
    """A closed range of time codes, `start <= time <= end`, optionally resampled every `step` time codes.

    Without a step the authored samples inside the range are kept. With a step the poses are read at `start`,
    `start + step`, ... up to `end`, interpolated by USD where no sample is authored.
    """

    start: float
    end: float
    step: float | None = None

    def __post_init__(self) -> None:
        """Refuse ranges that contain nothing."""
        values = [self.start, self.end] if self.step is None else [self.start, self.end, self.step]
        if not all(math.isfinite(value) for value in values):
            raise OptionError(f"`frames`: frame range {self}: start, end and step must be finite time codes")
        if self.end < self.start:
            raise OptionError(f"`frames`: frame range {self}: the end lies before the start")
        if self.step is None:
            return
        if self.step <= 0:
            raise OptionError(f"`frames`: frame range {self}: the step must be above 0")
        if (self.end - self.start) / self.step >= MAX_FRAMES:
            raise OptionError(f"`frames`: frame range {self}: more than {MAX_FRAMES} frames")

    def __str__(self) -> str:
        """The range as it is written on the command line."""
        text = f"{self.start:g}:{self.end:g}"
        return text if self.step is None else f"{text}:{self.step:g}"

    @classmethod
    def parse(cls, text: str) -> FrameRange:
        """Read `START:END` or `START:END:STEP` (time codes).

        Raises:
            OptionError: the text is no such range.
        """
        parts = text.split(":")
        if len(parts) not in (2, 3):
            raise OptionError(f"`frames`: frame range '{text}': expected START:END or START:END:STEP, in time codes")
        try:
            numbers = [parse_number(part) for part in parts]
        except ValueError:
            raise OptionError(f"`frames`: frame range '{text}': START, END and STEP must be numbers") from None
        return cls(*numbers)

    def select(self, times: Sequence[float]) -> list[float]:
        """The time codes to read from an animation with samples at `times` (ascending); empty if none lies inside."""
        if self.step is None:
            return [time for time in times if self.start <= time <= self.end]
        count = math.floor((self.end - self.start) / self.step + STEP_TOLERANCE) + 1
        return [self.start + index * self.step for index in range(count)]
