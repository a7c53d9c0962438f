"""Volume morph against a dense solve."""

import numpy as np
import pytest

from tests.oracles.volume_morph import Multiquadrics

pytest.importorskip("scipy", reason="the extra `face`")
from warpqem.face.volume_morph import ROUNDING, VolumeMorph

NOSE = 0.7


@pytest.fixture
def points():
    """Feature points of two faces, and others."""
    rng = np.random.default_rng(4)
    source = rng.uniform(-1, 1, (20, 3))
    return source, source * [1.2, 0.9, 1.1] + rng.normal(scale=0.1, size=(20, 3)), rng.uniform(-1.5, 1.5, (50, 3))


def test_morph_takes_the_points_where_they_should_go(points):
    source, target, _ = points
    np.testing.assert_allclose(VolumeMorph(source, target, NOSE)(source), target, atol=1e-9)


def test_morph_and_its_derivative_match_the_oracle(points):
    source, target, others = points
    morph, oracle = VolumeMorph(source, target, NOSE), Multiquadrics(source, target, ROUNDING * NOSE)
    np.testing.assert_allclose(morph(others), oracle(others), atol=1e-9)
    np.testing.assert_allclose(morph.derivative(others), oracle.derivative(others), atol=1e-4)


def test_linear_maps_come_out_as_they_are(points):
    source, _, others = points
    matrix = np.array([[1.1, 0.2, 0], [0, 0.8, 0.1], [0.3, 0, 1.2]])
    morph = VolumeMorph(source, source @ matrix.T + 0.5, NOSE)
    np.testing.assert_allclose(morph(others), others @ matrix.T + 0.5, atol=1e-9)
