"""Frame ranges."""

from __future__ import annotations

import pytest

from warpqem.errors import OptionError
from warpqem.usd.read.time_codes import FrameRange


def test_range_without_step_keeps_the_samples_inside():
    assert FrameRange.parse("2:5").select([1.0, 2.0, 2.5, 5.0, 6.0]) == [2.0, 2.5, 5.0]


def test_range_with_step_resamples():
    assert FrameRange.parse("0:5:2").select([0.0, 5.0]) == [0.0, 2.0, 4.0]


def test_step_that_is_no_binary_fraction_includes_the_end():
    assert FrameRange.parse("0:1:0.1").select([])[-1] == pytest.approx(1.0)


def test_negative_time_codes_are_read():
    assert FrameRange.parse("-3:-1").select([-4.0, -2.0, 0.0]) == [-2.0]


@pytest.mark.parametrize("text", ["5", "1:2:3:4", "a:b", "5:1", "1:5:0", "1:5:-1", "nan:5", "0:1e9:1e-3", ":"])
def test_wrong_range_is_refused(text):
    with pytest.raises(OptionError, match="frame range"):
        FrameRange.parse(text)
