"""Figures as text."""

from __future__ import annotations

import math
from decimal import ROUND_CEILING, Context, Decimal

__all__ = ["rounded_up"]


def rounded_up(value: float, digits: int = 4) -> str:
    """A number of so many digits that is no smaller: what nothing is above in full stays so as text."""
    if math.isfinite(value):
        value = float(Context(prec=digits, rounding=ROUND_CEILING).create_decimal(Decimal(repr(float(value)))))
    return f"{value:.{digits}g}"
