"""Heat map: ends, scale, order of the colours."""

import numpy as np
import pytest

from warpqem.errors import OptionError
from warpqem.measure import distance_colors

FACES = np.array([[0, 1, 2], [0, 2, 3]])
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
BLUE = np.array([0.058, 0.0004, 0.089])  # linear values of viridis' first and last colour
YELLOW = np.array([0.985, 0.799, 0.018])


def raised(*heights):
    return SQUARE + np.array([[0, 0, h] for h in heights])


def test_ends_are_blue_and_yellow(device):
    colors, scale = distance_colors(SQUARE, FACES, raised(0, 0.1, 0, 0.1), FACES, device=device)
    assert colors.shape == (1, 4, 3)
    assert colors.dtype == np.float32
    np.testing.assert_allclose(colors[0, [0, 2]], [BLUE, BLUE], atol=2e-3)
    np.testing.assert_allclose(colors[0, [1, 3]], [YELLOW, YELLOW], atol=2e-3)
    assert scale == pytest.approx(100 * 0.1 / np.sqrt(2), rel=1e-10)


def test_given_scale_is_kept_and_clamps(device):
    colors, scale = distance_colors(SQUARE, FACES, raised(0, 0.05, 0.1, 0.2), FACES, scale=5.0, device=device)
    assert scale == 5.0
    np.testing.assert_array_equal(colors[0, 2], colors[0, 3])


def test_brightness_grows_with_distance(device):
    heights = np.linspace(0, 0.3, 40)
    test = np.stack([raised(h, 0, 0, 0.3) for h in heights])
    colors, _ = distance_colors(np.repeat(SQUARE[None], 40, axis=0), FACES, test, FACES, device=device)
    luminance = colors[:, 0] @ np.array([0.2126, 0.7152, 0.0722])
    assert (np.diff(luminance) > 0).all()


def test_no_error_gives_scale_zero_and_the_first_colour(device):
    colors, scale = distance_colors(SQUARE, FACES, SQUARE, FACES, device=device)
    assert scale == 0
    np.testing.assert_allclose(colors[0], np.tile(BLUE, (4, 1)), atol=2e-3)


@pytest.mark.parametrize("scale", [0, -1, float("nan")])
def test_scale_must_be_positive(scale):
    with pytest.raises(OptionError, match="scale"):
        distance_colors(SQUARE, FACES, SQUARE, FACES, scale=scale)
