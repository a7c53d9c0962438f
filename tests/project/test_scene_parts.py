"""What the generators of the scenes are made of."""

import numpy as np

from scenes.diffusion import diffuse, strongest_influences
from scenes.implicit import ellipsoid, project, round_cone, surface, union
from scenes.remesh import well_shaped
from tests.support.meshes import shape_quality


def test_round_cone_is_the_exact_distance() -> None:
    field = round_cone((0.0, 0.0, 0.0), (0.0, 2.0, 0.0), 0.5, 0.5)
    points = np.array([[1.5, 1.0, 0.0], [0.0, 3.0, 0.0], [0.0, -2.0, 0.0], [0.1, 1.0, 0.0]])
    np.testing.assert_allclose(field(points), [1.0, 0.5, 1.5, -0.4], atol=1e-12)


def test_projection_and_remeshing_keep_the_vertices_on_the_surface() -> None:
    ball = ellipsoid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    points, faces = surface(ball, (-1.2,) * 3, (1.2,) * 3, 0.1)
    points, faces, _ = well_shaped(ball, points, faces, lambda p: np.ones(len(p)), 1000, set())
    assert len(faces) == 1000
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1.0, atol=1e-3)
    assert shape_quality(points, faces).min() > 0.5


def test_projection_reaches_the_zero_set() -> None:
    field = union(0.2, round_cone((0, 0, 0), (1, 0, 0), 0.5, 0.3), round_cone((0, 0, 0), (0, 1, 0), 0.5, 0.2))
    near = np.random.default_rng(1).normal(size=(100, 3))
    near /= np.linalg.norm(near, axis=1)[:, None]
    assert np.abs(field(project(field, 0.6 * near, 0.1, rounds=12))).max() < 1e-4


def test_diffusion_does_not_cross_between_separate_parts() -> None:
    triangle = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    points = np.concatenate([triangle, triangle + np.array([0.0, 0.0, 1e-3])])
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    values = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])[:, None]
    result = diffuse(points, faces, values, np.full(6, 1.0))[:, 0]
    assert (result[:3] > 0.0).all()
    np.testing.assert_array_equal(result[3:], 0.0)


def test_strongest_influences_are_sorted_and_renormalised() -> None:
    indices, weights = strongest_influences(np.array([[0.1, 0.4, 0.005, 0.2, 0.3]]), count=2)
    np.testing.assert_array_equal(indices, [[1, 4]])
    np.testing.assert_allclose(weights, [[4 / 7, 3 / 7]], rtol=1e-6)
