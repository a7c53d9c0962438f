"""Triangles that texture coordinates turn over."""

import numpy as np
import pytest

from tests.oracles import turned_triangles as oracle
from tests.support import meshes
from warpqem.attribute_fit.turned_triangles import turned_back


@pytest.mark.parametrize("seed", range(8))
def test_triangles_are_turned_back_as_numpy_does_to_the_bit(seed):
    points, faces = meshes.grid(12, 12)
    random = np.random.default_rng(seed)
    values = np.ascontiguousarray(points[:, :2], dtype=np.float64)
    signs = np.ones(len(faces), dtype=np.int8)
    signs[random.choice(len(faces), 20, replace=False)] = 0
    moved = random.choice(len(values), 6 + 4 * seed, replace=False)
    values[moved] += random.normal(scale=0.08, size=(len(moved), 2))
    bounds = (np.zeros_like(values), np.ones_like(values))
    found = turned_back(faces, values, signs, *bounds)
    assert not np.array_equal(found, values)
    assert found.tobytes() == oracle.turned_back(faces, values, signs, *bounds).tobytes()


def test_values_that_turn_nothing_over_stay():
    points, faces = meshes.grid(4, 4)
    # Beyond their bounds, which nothing brings them back to.
    values = points[:, :2].astype(np.float64) + 7.0
    signs = np.ones(len(faces), dtype=np.int8)
    assert np.array_equal(turned_back(faces, values, signs, np.zeros_like(values), np.ones_like(values)), values)
