"""CIEDE2000: the published pairs, and another implementation."""

import numpy as np
import pytest
from skimage.color import deltaE_ciede2000, rgb2lab

from warpqem.measure.color_difference import ciede2000, color_difference, linear_to_lab

# Sharma, Wu and Dalal (2005), table 1: pairs that find the usual mistakes in the hues.
PAIRS = [
    ((50, 2.6772, -79.7751), (50, 0, -82.7485), 2.0425),
    ((50, -1.3802, -84.2814), (50, 0, -82.7485), 1.0000),
    ((50, 0, 0), (50, -1, 2), 2.3669),
    ((50, 2.49, -0.001), (50, -2.49, 0.0009), 7.1792),
    ((50, 2.49, -0.001), (50, -2.49, 0.0011), 7.2195),
    ((50, 2.5, 0), (50, 0, -2.5), 4.3065),
    ((50, 2.5, 0), (73, 25, -18), 27.1492),
    ((50, 2.5, 0), (58, 24, 15), 19.4535),
    ((22.7233, 20.0904, -46.694), (23.0331, 14.973, -42.5619), 2.0373),
    ((2.0776, 0.0795, -1.135), (0.9033, -0.0636, -0.5514), 0.9082),
]


@pytest.mark.parametrize(("first", "second", "expected"), PAIRS)
def test_published_pairs(first, second, expected):
    [found] = ciede2000(np.array([first], dtype=float), np.array([second], dtype=float))
    assert found == pytest.approx(expected, abs=5e-5)


def test_random_colors_agree_with_another_implementation():
    rng = np.random.default_rng(0)
    one, other = rng.uniform([0, -100, -100], [100, 100, 100], (2, 5000, 3))
    np.testing.assert_allclose(ciede2000(one, other), deltaE_ciede2000(one, other), atol=1e-9)


def test_linear_colors_are_those_of_srgb_without_its_curve():
    linear = np.random.default_rng(1).random((200, 3))
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(linear_to_lab(linear), rgb2lab(encoded[None])[0], atol=0.02)


def test_black_and_white_are_100_apart():
    assert color_difference(np.zeros((1, 3)), np.ones((1, 3)))[0] == pytest.approx(100, abs=1e-6)
