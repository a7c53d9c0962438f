"""What to give in place of a number that is meant well: a percentage, a decimal comma, a length."""

from __future__ import annotations

import re
from collections.abc import Collection
from typing import Any

from warpqem.arguments.limits import Limits

__all__ = ["number_hint"]

LENGTH_UNITS = ("mm", "cm", "dm", "m", "km", "in", "ft")
# Text that may stand behind a number of an option whose unit the help shows so.
SUFFIXES = {"PX": ("px", "pixel", "pixels"), "DEG": ("deg", "degree", "degrees", "°"), "SECONDS": ("s", "sec")}
# Options that count the faces to keep.
FACE_COUNTS = ("faces", "target_faces")
# Numbers from here on would be shown with an exponent, which nobody meant.
MAX_SHOWN = 1e12


def number_hint(
    name: str,
    value: Any,
    limits: Limits | None,
    unit: str | None = None,
    whole: bool = False,
    names: Collection[str] = (),
) -> str:
    """What an error about a number says at its end, such as "; for 10 % give 0.1"; empty for nothing.

    Args:
        name: of the option.
        value: what was given.
        limits: the numbers that it takes.
        unit: what its numbers count, as its help shows it.
        whole: it takes whole numbers only.
        names: of all options that may be given beside it.
    """
    number, suffix = _parts(value, whole)
    if number is None:
        return ""
    is_share = limits is not None and limits.high == 1.0
    if suffix == "%":
        return _for_percentage(name, number, is_share, unit, names)
    if suffix in LENGTH_UNITS and unit == "PCT":
        length = (
            f"; for a length give `max_distance` {value}" if name == "max_error" and "max_distance" in names else ""
        )
        return f"; it is in % of the diagonal{length}"
    if suffix:
        return f"; give {number:.12g}" if suffix in SUFFIXES.get(unit or "", ()) else ""
    if is_share and 1.0 < number <= 100.0:
        return f"; for {number:g} % give {number / 100:g}"
    if name in FACE_COUNTS and 0.0 < number < 1.0 and "ratio" in names:
        return f"; for a share give `ratio` {number:g}"
    fits = (limits is None or number in limits) and (not whole or number.is_integer()) and abs(number) < MAX_SHOWN
    return f"; give {number:.12g}" if isinstance(value, str) and fits else ""


def _for_percentage(name: str, number: float, is_share: bool, unit: str | None, names: Collection[str]) -> str:
    if is_share and 0.0 < number <= 100.0:
        return f"; give {number / 100:g}"
    if unit == "PCT" and number > 0.0:
        return f"; it is in % anyway: give {number:g}"
    if name in FACE_COUNTS and "ratio" in names and 0.0 < number <= 100.0:
        return f"; for a share give `ratio` {number / 100:g}"
    return ""


def _parts(value: Any, whole: bool) -> tuple[float | None, str]:
    """A number that text, or a number, begins with, and what stands behind it."""
    text = value.strip() if isinstance(value, str) else str(value)
    fraction = re.fullmatch(r"(\d{1,9})\s*/\s*(\d{1,9})", text)
    if fraction and int(fraction[2]):
        return int(fraction[1]) / int(fraction[2]), ""
    found = re.fullmatch(r"(-?[\d.,_]{1,20}(?:[eE][-+]?\d{1,2})?)\s*([^\W\d_]*|[%°])", text)
    if not found:
        return None, ""
    digits = found[1]
    if whole and re.fullmatch(r"-?\d{1,3}(,\d{3})+", digits):
        digits = digits.replace(",", "")
    try:
        # One comma is that of decimals where there is no point.
        return float(digits.replace(",", ".")), found[2]
    except ValueError:
        return None, ""
