"""Fitted texture coordinates stay in the tiles that the input's are in."""

import functools

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.support import meshes
from tests.support.attribute_fit import Fitting, fitting
from warpqem.attribute_fit.texture import fit_texture


@functools.cache
def wavy_plane(size: int, cut: bool) -> Fitting:
    """A plane with waves; with a seam at x = 0.5 if it is cut."""
    points, faces = meshes.grid(size, size)
    ridge = np.flatnonzero(points[:, 0] == 0.5)
    points = points.astype(np.float32)
    points[:, 2] = 0.1 * np.sin(6 * points[:, 0] + size) * np.cos(5 * points[:, 1])
    return fitting(points, faces, np.stack([ridge[:-1], ridge[1:]], axis=1) if cut else None, ratio=0.15)


def mirrored(x: np.ndarray) -> np.ndarray:
    """Back and forth between 0 and 1."""
    return np.abs((x + 1) % 2 - 1)


def fitted(fit: Fitting, corners: np.ndarray) -> np.ndarray:
    values = corners.reshape(-1, 2)
    found = fit_texture(fit.result.faces, fit.layout, values, fit.start(corners), fit.signs(values))
    return found[fit.layout.corner_row]


@settings(max_examples=25, deadline=None)
@given(st.sampled_from([12, 14, 18]), st.floats(0.5, 4), st.floats(0, 6.3), st.integers(-3, 3))
# These left the tile by more than a tenth of it.
@example(14, 2.0, 0.6, 0)
@example(16, 3.3, 1.2, 0)
def test_mirrored_tile_is_not_left(size, times, angle, tile):
    fit = wavy_plane(size, cut=False)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    corners = times * fit.points[fit.faces][:, :, :2].astype(np.float64) @ turn + [-0.3, 0.2]
    found = fitted(fit, tile + mirrored(corners))
    assert tile <= found.min()
    assert found.max() <= tile + 1


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from([(1, 0), (0, 1), (5, -7)]))
def test_islands_stay_in_their_tiles(seed, step):
    fit = wavy_plane(14, cut=True)
    right = fit.points[fit.faces].mean(axis=1)[:, 0] > 0.5
    corners = fit.points[fit.faces][:, :, :2].astype(np.float64)
    # Each island fills its tile, and is bent along the borders.
    corners[..., 0] = 2 * (corners[..., 0] - np.where(right, 0.5, 0.0)[:, None])
    a, b = np.random.default_rng(seed).uniform(-0.3, 0.3, 2)
    corners = mirrored(corners + a * np.sin(7 * corners[..., ::-1]) + b * np.sin(13 * corners))
    found = fitted(fit, corners + right[:, None, None] * np.array(step))
    at_right = fit.result.points[0][fit.result.faces].mean(axis=1)[:, 0] > 0.5
    found -= at_right[:, None, None] * np.array(step)
    assert found.min() >= 0
    assert found.max() <= 1


@pytest.mark.parametrize("border", [0.0, 1.0])
def test_values_on_the_border_of_a_tile_stay_on_it(border):
    fit = wavy_plane(12, cut=False)
    corners = fit.points[fit.faces][:, :, :2].astype(np.float64)
    corners[..., 0] = border
    assert (fitted(fit, corners)[..., 0] == border).all()


def test_values_across_tiles_are_fitted_in_all_of_them():
    fit = wavy_plane(14, cut=False)
    corners = 3.0 * fit.points[fit.faces][:, :, :2].astype(np.float64)
    found = fitted(fit, corners)
    np.testing.assert_allclose(found, 3.0 * fit.result.points[0][fit.result.faces][:, :, :2], atol=0.1)
