"""Lengths with a unit, in the units of a stage."""

import pytest

from warpqem.errors import OptionError
from warpqem.usd.read.lengths import parse_length


@pytest.mark.parametrize(
    ("value", "meters_per_unit", "length"),
    [
        ("2mm", 0.01, 0.2),
        ("2 cm", 0.01, 2.0),
        ("1m", 1.0, 1.0),
        ("1in", 0.0254, 1.0),
        ("2ft", 1.0, 0.6096),
        (0.5, 9, 0.5),
    ],
)
def test_a_unit_counts_by_the_metres_of_the_stage(value, meters_per_unit, length):
    assert parse_length(value, meters_per_unit) == pytest.approx(length)


@pytest.mark.parametrize("value", ["2 km", "mm", "-1mm", "0", "nan", "inf", "1e400m", True, ""])
def test_what_is_no_length_is_refused(value):
    with pytest.raises(OptionError, match="max_distance"):
        parse_length(value, 1.0)


@pytest.mark.parametrize("meters_per_unit", [0.0, -1.0, float("nan"), float("inf")])
def test_a_unit_needs_the_size_of_those_of_the_stage(meters_per_unit):
    with pytest.raises(OptionError, match=f"max_distance '2mm': metersPerUnit of the stage is {meters_per_unit:g}"):
        parse_length("2mm", meters_per_unit)
    assert parse_length("2", meters_per_unit) == 2.0
