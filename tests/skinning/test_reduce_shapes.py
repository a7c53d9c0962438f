"""Fewer blend shapes for a simplified mesh."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.meshes import bumpy_sphere
from warpqem.errors import MeshShapeError, OptionError
from warpqem.skinning import reduce_shapes

REST, FACES = bumpy_sphere(1)
RNG = np.random.default_rng(0)


def bump(centre, height=0.2) -> np.ndarray:
    """Offsets along the normals of a sphere around one of its points."""
    unit = REST / np.linalg.norm(REST, axis=1, keepdims=True)
    return height * unit * np.exp(8.0 * (unit @ np.asarray(centre, dtype=float) - 1.0))[:, None]


X, Y, Z = bump([1, 0, 0]), bump([0, 1, 0]), bump([0, 0, 1])


def test_shape_that_is_a_sum_of_others_is_merged_into_them():
    used = np.array([[0.2, 0.1, 0.5, 0.3], [0.0, 0.4, 0.6, 0.9]])
    done = reduce_shapes(REST, FACES, np.stack([X, Y, X + Y, Z]), used, shapes=3)
    assert done.removed.tolist() == [2]
    assert done.kept.tolist() == [0, 1, 3]
    np.testing.assert_allclose(done.parts, [[1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1]], atol=1e-3)
    np.testing.assert_allclose(done.weights, [[0.7, 0.6, 0.3], [0.6, 1.0, 0.9]], atol=1e-3)
    assert done.used_errors[-1] < 1e-3


def test_half_a_shape_gives_half_of_its_weight():
    done = reduce_shapes(REST, FACES, np.stack([X, 0.5 * X, Y]), shapes=2)
    assert done.removed.tolist() == [1]
    np.testing.assert_allclose(done.parts[1], [0.5, 0.0], atol=1e-6)


def test_shapes_that_the_mesh_does_not_show_go_without_error():
    nothing = np.zeros_like(X)
    done = reduce_shapes(REST, FACES, np.stack([nothing, X, nothing, Y]), max_error=1e-6)
    assert sorted(done.removed) == [0, 2]
    assert not done.random_errors.any()


def test_shape_that_no_other_can_replace_loses_what_it_moves():
    done = reduce_shapes(REST, FACES, np.stack([X, 0.1 * Y, Z]), np.array([[1.0, 1.0, 1.0]]), shapes=2)
    assert done.removed.tolist() == [1]
    area = 0.1 * Y
    diagonal = np.linalg.norm(np.ptp(REST, axis=0))
    assert 0 < done.used_errors[-1] <= 100 * np.linalg.norm(area, axis=1).max() / diagonal


def test_opposite_shape_has_no_negative_part():
    done = reduce_shapes(REST, FACES, np.stack([X, -0.1 * X, Y]), shapes=2)
    assert done.removed.tolist() == [1]
    assert not done.parts[1].any()


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**31), count=st.integers(2, 7))
def test_errors_grow_and_weights_stay_within_0_and_1(seed, count):
    rng = np.random.default_rng(seed)
    base = np.stack([X, Y, Z])
    offsets = np.einsum("sb,bvi->svi", rng.uniform(0, 1, (count, 3)), base) + rng.normal(0, 0.01, (count, *X.shape))
    used = rng.uniform(0, 1, (9, count))
    done = reduce_shapes(REST, FACES, offsets, used, shapes=1)
    assert done.counts.tolist() == list(range(count, 0, -1))
    assert (done.parts >= 0).all()
    assert (done.parts[done.kept] == np.eye(count)[:, done.kept][done.kept]).all()
    assert ((done.weights >= 0) & (done.weights <= 1)).all()
    # Weights are cut off at 1 for these figures, which may take a little off again.
    total = np.hypot(done.used_errors, done.random_errors)
    assert (total[1:] >= 0.9 * total[:-1]).all()


def displaced(offsets, weights) -> np.ndarray:
    return np.einsum("fs,svi->fvi", weights, offsets)


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    factors=st.lists(st.sampled_from([0.25, 0.5, 1.0, 2.0]), min_size=2, max_size=6),
    lowest=st.sampled_from([-0.5, 0.0]),
    is_used=st.booleans(),
)
def test_multiples_of_one_shape_merge_without_error_and_weights_stay_within_their_range(seed, factors, lowest, is_used):
    rng = np.random.default_rng(seed)
    offsets = np.concatenate([np.array(factors)[:, None, None] * X, Y[None]])
    used = rng.uniform(lowest, 1, (9, len(offsets)))
    # Each weight reaches its ends.
    used[:2] = [[lowest], [1.0]]
    done = reduce_shapes(REST, FACES, offsets, used if is_used else None, max_error=0.01)
    assert len(done.kept) == 2
    assert max(done.used_errors[-1], done.random_errors[-1]) <= 0.01
    weights = rng.uniform(0, 1, (20, len(offsets)))
    if is_used:
        weights = np.concatenate([weights, used])
    lower, upper = np.full((2, 2), [[lowest if is_used else 0.0], [1.0]])
    found = done.corrected(weights, upper, lower)
    assert ((found >= lower - 1e-9) & (found <= upper + 1e-9)).all()
    kept = offsets[done.kept] * done.scales[:, None, None]
    np.testing.assert_allclose(displaced(kept, found), displaced(offsets, weights), atol=1e-6)
    if is_used:
        np.testing.assert_allclose(done.weights, done.corrected(used, upper, lower))


def test_equal_shapes_merge_without_loss_by_count_too():
    offsets = np.stack([X, X, Y, X])
    used = RNG.uniform(0.5, 1.0, (6, 4))
    done = reduce_shapes(REST, FACES, offsets, used, shapes=2)
    assert max(done.used_errors[-1], done.random_errors[-1]) < 1e-6
    moved = np.tensordot(done.weights * done.scales, offsets[done.kept], axes=1)
    np.testing.assert_allclose(moved, np.tensordot(used, offsets, axes=1), atol=1e-12)
    assert done.weights.max() <= 1.0


def test_shapes_are_not_scaled_by_count_where_that_gains_little():
    # What goes is unlike what stays: it is lost, scaled or not.
    done = reduce_shapes(REST, FACES, np.stack([X, 0.3 * Y]), np.ones((1, 2)), shapes=1)
    assert done.scales.tolist() == [1.0]
    assert done.random_errors[-1] > 0


def test_shapes_are_scaled_only_where_weights_are_cut_off_and_they_may_be():
    offsets = np.stack([X, X, X, X])
    used = np.ones((1, 4))
    assert reduce_shapes(REST, FACES, offsets, used, shapes=1).scales.tolist() == [4.0]
    # Who sets weights without an animation knows the shapes as they are.
    assert reduce_shapes(REST, FACES, offsets, shapes=1).scales.tolist() == [1.0]
    unseen = reduce_shapes(REST, FACES, np.stack([X, 1e-3 * X]), used[:, :2], shapes=1)
    assert unseen.scales.tolist() == [1.0]
    loose = reduce_shapes(REST, FACES, np.stack([X, 0.01 * X]), max_error=0.1)
    assert (loose.removed.tolist(), loose.scales.tolist()) == ([1], [1.0])
    for more in ({"scalable": []}, {"inbetweens": [{0.5: Y}] * 4}):
        assert reduce_shapes(REST, FACES, offsets, used, shapes=1, **more).scales.tolist() == [1.0]
        done = reduce_shapes(REST, FACES, offsets, max_error=0.01, **more)
        assert len(done.kept) == 4
        assert done.scales.tolist() == [1.0] * 4


def test_no_shape_may_be_kept_or_take_over_weight():
    done = reduce_shapes(REST, FACES, np.stack([X, X, Y]), shapes=2, keep=[], heirs=[])
    assert len(done.removed) == 1
    assert not done.parts[done.removed].any()


def test_sum_of_two_shapes_merges_into_them_within_a_limit():
    done = reduce_shapes(REST, FACES, np.stack([X, Y, X + Y]), max_error=0.01)
    assert done.removed.tolist() == [2]
    np.testing.assert_allclose(done.scales, [2.0, 2.0], atol=1e-3)
    np.testing.assert_allclose(done.corrected(np.ones(3)), [1.0, 1.0], atol=1e-3)


AXES, HEIGHTS = np.concatenate([np.eye(3), -np.eye(3)]), np.geomspace(0.001, 0.2, 6)


def test_limit_on_the_error_holds_for_used_and_random_weights():
    offsets = np.stack([bump(axis, h) for axis, h in zip(AXES, HEIGHTS, strict=True)])
    used = RNG.uniform(size=(5, 6))
    done = reduce_shapes(REST, FACES, offsets, used, max_error=0.3)
    assert 0 < len(done.removed) < 6
    assert max(done.used_errors[-1], done.random_errors[-1]) <= 0.3
    further = reduce_shapes(REST, FACES, offsets, used, shapes=max(len(done.kept) - 1, 1))
    assert max(further.used_errors[-1], further.random_errors[-1]) > 0.3


def test_kept_shapes_stay_and_others_get_no_weight():
    done = reduce_shapes(REST, FACES, np.stack([X, X, Y]), shapes=2, keep=[0], heirs=[2])
    assert 0 in done.kept
    assert not done.parts[done.removed[0]][: np.searchsorted(done.kept, 2)].any()


def test_weights_beyond_one_stay_as_they_are_used():
    done = reduce_shapes(REST, FACES, np.stack([X, 0.01 * Z, Y]), np.array([[1.2, 1.0, 0.5]]), shapes=2)
    np.testing.assert_allclose(done.weights, [[1.2, 0.5]])


def test_negative_weights_stay_where_nothing_is_merged_and_count_in_what_is():
    used = np.array([[-0.5, 0.2, -0.4, -0.3], [-0.1, 0.1, -0.9, 0.2]])
    done = reduce_shapes(REST, FACES, np.stack([X, Y, X, Z]), used, shapes=3, heirs=[0], scalable=[])
    assert done.removed.tolist() == [2]
    # The used weights of the first shape go down to -0.5.
    np.testing.assert_allclose(done.weights, [[-0.5, 0.2, -0.3], [-0.5, 0.1, 0.2]], atol=1e-6)
    assert done.used_errors[-1] > 0.1
    others = done.corrected(np.array([0.5, -2.0, -0.1, 3.0]))
    np.testing.assert_allclose(others, [0.4, -2.0, 3.0], atol=1e-6)


def test_inbetween_that_is_on_the_straight_way_goes_and_another_stays():
    curved = {0.5: 0.5 * X + 0.5 * Z}
    straight = {0.25: 0.25 * Y}
    done = reduce_shapes(REST, FACES, np.stack([X, Y, 0.1 * Z]), shapes=2, inbetweens=[curved, straight, {}])
    assert done.removed.tolist() == [2]
    assert done.inbetweens == [(0.5,), (), ()]


@pytest.mark.parametrize(
    ("change", "raised", "message"),
    [
        ({"shapes": None}, OptionError, "one of shapes and max_error is needed"),
        ({"shapes": 0}, OptionError, "shapes must be"),
        ({"max_error": -1}, OptionError, "max_error must be"),
        ({"weights": np.zeros((2, 5))}, MeshShapeError, r"weights must have shape \(F, 2\)"),
        ({"keep": [2]}, MeshShapeError, "keep at 0 is 2, but there are 2 shapes"),
        ({"inbetweens": [{}]}, MeshShapeError, "inbetweens are of 1 shapes"),
        ({"inbetweens": [{}, {1.5: X}]}, OptionError, "an inbetween of shape 1 has the weight 1.5"),
    ],
)
def test_wrong_arguments_are_named(change, raised, message):
    with pytest.raises(raised, match=message):
        reduce_shapes(REST, FACES, np.stack([X, Y]), **{"shapes": 1, **change})
