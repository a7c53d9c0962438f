"""Quadric scales from morph targets."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import warpqem
from tests.oracles import morph as oracle
from tests.support.meshes import bumpy_sphere
from tests.support.moving_meshes import kept_near
from warpqem.costs.blend_shape_weights import morph_distances, morph_weights
from warpqem.errors import MeshShapeError, OptionError

NEUTRAL = np.zeros((9, 3))
# Vertex v moves by v along x in the first target, by 2 v along y in the second.
TARGETS = np.stack([np.arange(9)[:, None] * np.array([1.0, 0, 0]), np.arange(9)[:, None] * np.array([0, 2.0, 0])])


def test_distances_add_up_over_the_targets():
    np.testing.assert_allclose(morph_distances(NEUTRAL, TARGETS), 3 * np.arange(9))


def test_thirds_are_those_of_the_paper():
    weights = morph_weights(NEUTRAL, TARGETS[:, ::-1])
    np.testing.assert_array_equal(weights, np.float32([1, 1, 1, 1, 0.66, 0.66, 0.33, 0.33, 0.33]))


@pytest.mark.parametrize(("count", "groups"), [(1, (0, 0, 1)), (2, (0, 1, 1)), (7, (2, 2, 3)), (9, (3, 2, 4))])
def test_bounds_of_the_thirds_go_by_the_index_from_one(count, groups):
    # Table 1: 0.33 up to N / 3, 1.0 from 2 N / 3, 0.66 between.
    weights = morph_weights(NEUTRAL[:count], TARGETS[:, :count])
    assert tuple(int((weights == np.float32(scale)).sum()) for scale in (0.33, 0.66, 1.0)) == groups


def test_rank_is_linear_and_equal_distances_share_it():
    targets = np.array([[[0, 0, 0], [5, 0, 0], [5, 0, 0], [90, 0, 0]]], dtype=float)
    np.testing.assert_allclose(morph_weights(NEUTRAL[:4], targets, "rank"), [0.33, 0.665, 0.665, 1.0], rtol=1e-6)


def test_distance_is_linear():
    targets = np.array([[[0, 0, 0], [1, 0, 0], [4, 0, 0]]], dtype=float)
    expected = 0.33 + 0.67 * np.array([0, 0.25, 1])
    np.testing.assert_allclose(morph_weights(NEUTRAL[:3], targets, "distance"), expected, rtol=1e-6)


def test_usage_leaves_out_a_target_that_the_animation_never_shows():
    animation = np.array([[0.0, 0.0], [0.5, 0.0], [-1.0, 0.0]])
    one = TARGETS * np.array([1, 0])[:, None, None]
    np.testing.assert_allclose(morph_distances(NEUTRAL, TARGETS, animation), 0.5 * np.arange(9))
    np.testing.assert_array_equal(
        morph_weights(NEUTRAL, TARGETS, "usage", animation), morph_weights(NEUTRAL, one, "distance")
    )


def test_still_targets_weigh_all_vertices_alike():
    still = np.zeros((2, 9, 3))
    assert (morph_weights(NEUTRAL, still, "distance") == 1).all()
    assert (morph_weights(NEUTRAL, still, "rank") == 1).all()


def test_function_gets_the_distances():
    weights = morph_weights(NEUTRAL, TARGETS, lambda distance: distance**2)
    np.testing.assert_allclose(weights, 9.0 * np.arange(9) ** 2)


def test_part_that_a_target_moves_keeps_more_vertices(device):
    points, faces = bumpy_sphere(3)
    moving = np.flatnonzero(points[:, 2] > 0.15)
    target = points.copy()
    target[moving, 2] += 0.3 * (points[moving, 2] - 0.15)
    frames = np.stack([points, target])
    scale = morph_weights(points, target[None])
    plain, weighted = (
        warpqem.simplify(frames, faces, ratio=0.28, quadric_scale=value, device=device) for value in (None, scale)
    )
    assert kept_near(weighted, moving) > kept_near(plain, moving)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ((NEUTRAL, TARGETS, "half"), OptionError, "unknown method 'half'"),
        ((NEUTRAL, TARGETS, "usage"), OptionError, "needs usage"),
        ((NEUTRAL, TARGETS[:, :5]), MeshShapeError, r"targets must be \(T, 9, 3\)"),
        ((NEUTRAL[:, :2], TARGETS), MeshShapeError, r"neutral must be \(V, 3\)"),
        ((NEUTRAL, TARGETS, "usage", np.ones(3)), MeshShapeError, r"usage must be \(2,\) or \(F, 2\)"),
        ((NEUTRAL, TARGETS, "usage", [np.nan, 1]), MeshShapeError, "usage of target 0 is not finite"),
        ((NEUTRAL, TARGETS * np.nan), MeshShapeError, "not finite at vertex 0"),
        ((NEUTRAL, TARGETS, lambda distance: distance[:2]), OptionError, "must return 9 numbers"),
    ],
)
def test_wrong_arguments_are_named(arguments, error, message):
    with pytest.raises(error, match=message):
        morph_weights(*arguments)


@given(count=st.integers(1, 40), seed=st.integers(0, 2**16))
def test_thirds_match_the_oracle(count, seed):
    # Whole numbers, so that distances are equal now and then.
    shapes = np.random.default_rng(seed).integers(-2, 3, (3, count, 3)).astype(np.float32)
    np.testing.assert_allclose(morph_distances(shapes[0], shapes[1:]), oracle.distance_sums(shapes[0], shapes[1:]))
    np.testing.assert_array_equal(
        morph_weights(shapes[0], shapes[1:]), oracle.thirds(shapes[0], shapes[1:]).astype(np.float32)
    )
