"""Lengths with or without a unit, in the units of a stage."""

from __future__ import annotations

import math
import re

from warpqem.errors import OptionError

__all__ = ["METRES", "parse_length"]

# Metres in each unit that may stand behind a number.
METRES = {"mm": 0.001, "cm": 0.01, "m": 1.0, "in": 0.0254, "ft": 0.3048}


def parse_length(value: float | str, meters_per_unit: float) -> float:
    """A length in units of a stage, from a number of these or text such as "2mm", "0.5 cm" or "0.1".

    Args:
        value: the number or text.
        meters_per_unit: metersPerUnit of the stage.

    Raises:
        OptionError: it is none, or not above 0; or it has a unit and the stage has none.
    """
    found = re.fullmatch(r"\s*([-+.\deE]+?)\s*([a-z]*)\s*", str(value), re.ASCII)
    try:
        number = float(found[1]) if found else math.nan
    except ValueError:
        number = math.nan
    unit = found[2] if found else ""
    if isinstance(value, bool) or (unit and unit not in METRES) or not 0.0 < number < math.inf:
        raise OptionError(
            f"max_distance {value!r}: expected a length, finite and above 0, in units of the stage, or with one of "
            f"{', '.join(METRES)}, such as 2mm"
        )
    if not unit:
        return number
    if not 0.0 < meters_per_unit < math.inf:
        raise OptionError(
            f"max_distance {value!r}: metersPerUnit of the stage is {meters_per_unit:g}, which is no size of a unit; "
            "give the length in units of the stage"
        )
    return number * METRES[unit] / meters_per_unit
