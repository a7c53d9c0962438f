"""Numbers of the command line: what is none, or outside its range, is an error that says which numbers there are."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import typer

from warpqem.arguments.limits import Limits
from warpqem.arguments.number_hints import number_hint
from warpqem.arguments.number_text import parse_number, parse_whole

__all__ = ["number", "usage_text", "whole"]

REFUSED = re.compile(r"^Invalid value for '(--[\w-]+)'[^:]*: (must be .*)$", re.DOTALL)


def number(limits: Limits, unit: str | None = None) -> Callable[[Any], float]:
    """A parser of numbers in a range; ``unit`` as the help shows it."""

    def read(value: Any) -> float:
        return _read(value, limits, unit, is_whole=False)

    return read


def whole(limits: Limits) -> Callable[[Any], int]:
    """A parser of whole numbers in a range."""

    def read(value: Any) -> int:
        return int(_read(value, limits, None, is_whole=True))

    return read


def usage_text(message: str) -> str:
    """A message of Typer, in the words of other errors of options where it is one of a parser here."""
    found = REFUSED.match(message)
    return f"{found[1]} {found[2]}" if found else message


def _read(value: Any, limits: Limits, unit: str | None, is_whole: bool) -> float:
    try:
        # Whole numbers not by way of a float, which rounds large ones.
        if isinstance(value, str):
            found = parse_whole(value) if is_whole else parse_number(value)
        else:
            found = int(value) if is_whole else float(value)
    except (ValueError, OverflowError):
        found = None
    if found is None or found not in limits:
        expected = f"a whole number {limits}" if is_whole else limits.expected
        hint = number_hint("", value, limits, unit, is_whole)
        # Not an error with a range of its own: Typer would put the value alone in place of the text.
        raise typer.BadParameter(f"must be {expected}, got {value if found is not None else repr(value)}{hint}")
    return found
