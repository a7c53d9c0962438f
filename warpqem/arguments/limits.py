"""Ranges of numbers that options take."""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["ABOVE_0", "ANY", "COUNT", "SHARE", "WEIGHTS", "Limits"]


@dataclass(frozen=True)
class Limits:
    """The numbers that an option takes: from ``low`` to ``high``, each with or without the end itself."""

    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False
    open_high: bool = False
    infinite: bool = False

    def __contains__(self, value: float) -> bool:
        """Whether a number is one of them; NaN is not, and infinity only where ``infinite`` says so."""
        above = value > self.low if self.open_low else value >= self.low
        below = value < self.high if self.open_high else value <= self.high
        return above and below and (self.infinite or math.isfinite(value))

    @property
    def expected(self) -> str:
        """What a message says must be given, such as "in (0, 1]" or "a finite number above 0"."""
        if self.infinite:
            return f"{self}, or inf"
        if not math.isinf(self.high):
            return str(self)
        return "a finite number" if math.isinf(self.low) else f"a finite number {self}"

    def __str__(self) -> str:
        """The range as messages and help name it, such as "in (0, 1]" or "above 0"."""
        if math.isinf(self.high):
            return f"{'above' if self.open_low else 'at least'} {self.low:g}"
        return f"in {'(' if self.open_low else '['}{self.low:g}, {self.high:g}{')' if self.open_high else ']'}"


ANY = Limits()
ABOVE_0 = Limits(0.0, open_low=True)
SHARE = Limits(0.0, 1.0, open_low=True)
COUNT = Limits(1)
# Squares of values times the weight of their attribute go into float32 costs, which end at 1e38.
WEIGHTS = Limits(0.0, 1e6)
