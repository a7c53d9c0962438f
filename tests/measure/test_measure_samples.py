"""Samples of a moving surface: right in the mean wherever they are dense, and few where little is to be found."""

import numpy as np
import pytest

from warpqem.measure import compare
from warpqem.measure.sample_draws import UNIFORM_SHARE, SampleDraws


def grid(side=20):
    x, y = np.meshgrid(np.linspace(0, 1, side) ** 2, np.linspace(0, 1, side))
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    faces = np.concatenate([corner[:, None] + [0, 1, side], corner[:, None] + [1, side + 1, side]])
    return np.stack([x.ravel(), y.ravel(), np.zeros(side * side)], axis=1), faces


def areas_of(points, faces):
    corner = points[faces]
    return np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) / 2


def spot(place):
    """A distance that is large in a spot of a hundredth of the unit square only."""
    return 0.01 + np.maximum(0.0, 1.0 - 20.0 * np.linalg.norm(place[..., :2] - [0.7, 0.4], axis=-1))


def positions(points, faces, draws):
    a, b, c = (points[faces[draws.face, k]] for k in range(3))
    return a + draws.place[..., :1] * (b - a) + draws.place[..., 1:] * (c - a)


def found_in(points, faces, *, learns, seeds=200, count=100):
    """Mean squares of a sample's distance in a second frame, over seeds; learned from others of the first frame."""
    areas = areas_of(points, faces)[None]
    found = []
    for seed in range(seeds):
        draws = SampleDraws(points[faces], seed, 0)
        if learns:
            first = draws.draw(areas, [0], 2000)
            draws.learn(first, spot(positions(points, faces, first)))
        second = draws.draw(areas, [1], count)
        found.append((spot(positions(points, faces, second)) ** 2 * second.weight).mean())
    return np.array(found)


def test_mean_square_is_unbiased_and_has_a_tenth_of_the_variance_where_one_spot_decides():
    points, faces = grid()
    x = (np.arange(2000) + 0.5) / 2000
    exact = (spot(np.stack(np.meshgrid(x, x), axis=-1)) ** 2).mean()
    plain, learned = (found_in(points, faces, learns=flag) for flag in (False, True))
    for found in (plain, learned):
        assert abs(found.mean() - exact) < 4 * found.std() / np.sqrt(len(found))
    assert learned.var() < 0.1 * plain.var()


def test_samples_without_a_difference_are_in_proportion_to_area_and_weigh_one():
    points, faces = grid()
    areas = areas_of(points, faces)
    draws = SampleDraws(points[faces], 0, 0)
    draws.learn(draws.draw(areas[None], [0], 50), np.full((1, 50), 0.1))
    drawn = draws.draw(areas[None], [1], 20000)
    np.testing.assert_allclose(drawn.weight, 1.0, rtol=1e-12)
    count = np.bincount(drawn.face[0], minlength=len(faces))
    # In strata, no face has two more or fewer than its share.
    assert (np.abs(count - 20000 * areas / areas.sum()) < 2).all()


def test_no_sample_weighs_more_than_the_uniform_share_lets_it():
    points, faces = grid()
    areas = areas_of(points, faces)[None]
    draws = SampleDraws(points[faces], 3, 1)
    first = draws.draw(areas, [0], 3000)
    draws.learn(first, spot(positions(points, faces, first)))
    assert draws.draw(areas, [1], 3000).weight.max() <= 1 / UNIFORM_SHARE


def test_faces_without_area_and_frames_without_error_are_no_trouble():
    points, faces = grid(4)
    faces = np.concatenate([faces, [[0, 0, 0]]])
    areas = areas_of(points, faces)[None]
    draws = SampleDraws(points[faces], 0, 0)
    first = draws.draw(areas, [0], 100)
    draws.learn(first, np.zeros((1, 100)))
    drawn = draws.draw(areas, [1], 1000)
    assert (drawn.face < len(faces) - 1).all()
    np.testing.assert_allclose(drawn.weight, 1.0, rtol=1e-12)


@pytest.mark.parametrize("frames", [1, 12])
def test_error_of_one_lost_spot_is_that_of_very_many_samples(device, frames):
    points, faces = grid(40)
    pulled = points.copy()
    pulled[:, 2] += 0.3 * spot(points)
    moving = np.stack([pulled * (1, 1, 1 + 0.05 * step) for step in range(frames)])
    flat = np.stack([points] * frames)
    few, many = (compare(moving, faces, flat, faces, samples=n, device=device).rms for n in (None, 50_000))
    assert few == pytest.approx(many, rel=0.03)
