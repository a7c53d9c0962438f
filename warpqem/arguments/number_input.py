"""Numbers, flags and functions from callers: taken in the types that hold one, refused by name."""

from __future__ import annotations

import math
import numbers
from collections.abc import Callable
from typing import Any

import numpy as np

from warpqem.arguments.limits import Limits
from warpqem.arguments.number_hints import number_hint
from warpqem.errors import OptionError

__all__ = ["check_function", "flag", "number_within", "real_number", "shown", "whole_number"]


def real_number(value: Any, name: str, expected: str, is_allowed: Callable[[float], bool]) -> float:
    """A number in the range of an option.

    Args:
        value: a Python or NumPy number, or an array of one number without axes; text and truth values are none.
        name: what the message calls it.
        expected: what the message says of the range.
        is_allowed: whether a number is in the range; it is asked about NaN and infinity too.

    Raises:
        OptionError: it is none, or outside the range.
    """
    number = _number(value)
    if number is None or not is_allowed(number):
        raise OptionError(f"{name} must be {expected}, got {shown(value)}")
    return number


def number_within(value: Any, name: str, limits: Limits) -> float:
    """A number in the range of an option.

    Raises:
        OptionError: it is none, or outside the range.
    """
    number = _number(value)
    if number is None or number not in limits:
        raise OptionError(f"{name} must be {limits.expected}, got {shown(value)}{number_hint(name, value, limits)}")
    return number


def whole_number(value: Any, name: str, least: int = 1, expected: str | None = None) -> int:
    """A whole number, such as 16, 16.0 or ``numpy.int64(16)``, that is at least ``least``.

    Raises:
        OptionError: it is none, or less; the message says ``expected``, or the least.
    """
    number = _number(value)
    if number is None or not math.isfinite(number) or number != int(number) or number < least:
        raise OptionError(f"{name} must be {expected or f'a whole number of at least {least}'}, got {shown(value)}")
    # Not by way of the float, which rounds large integers.
    return int(value)


def flag(value: Any, name: str) -> bool:
    """True or False, also as NumPy's, or as 1 or 0. Text is neither: "no" would count as true.

    Raises:
        OptionError: it is none of them.
    """
    if isinstance(value, (bool, np.bool_)) or (isinstance(value, (int, np.integer)) and value in (0, 1)):
        return bool(value)
    raise OptionError(f"{name} must be True or False, got {shown(value)}")


def check_function(value: Any, name: str) -> None:
    """Raise an OptionError for something that is neither None nor can be called."""
    if value is not None and not callable(value):
        raise OptionError(f"{name} must be a function or None, got {shown(value)}")


def shown(value: Any) -> str:
    """A value as messages show it: numbers plainly, all else with its type."""
    if isinstance(value, (bool, np.bool_)) or _number(value) is None:
        text = repr(value)
        return f"{text if len(text) <= 60 else text[:57] + '...'} ({type(value).__name__})"
    return str(value)


def _number(value: Any) -> float | None:
    """None for what is no real number."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, numbers.Real):
        return None
    try:
        return float(value)
    except OverflowError:
        # An integer or a fraction beyond double precision.
        return math.copysign(math.inf, -1 if str(value).startswith("-") else 1)
