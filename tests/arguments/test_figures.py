"""Figures as text."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from warpqem.arguments.figures import rounded_up


@given(st.floats(min_value=0.0, max_value=1e300).filter(lambda value: value == 0.0 or value > 1e-290))
def test_text_is_no_smaller_and_near(value):
    shown = float(rounded_up(value))
    assert value <= shown <= value * 1.0011
    assert rounded_up(shown) == rounded_up(value)


@pytest.mark.parametrize(
    ("value", "text"), [(0.79912, "0.7992"), (0.1, "0.1"), (2.0, "2"), (0.99991, "1"), (0.0, "0"), (math.inf, "inf")]
)
def test_text_of_a_figure(value, text):
    assert rounded_up(value) == text
