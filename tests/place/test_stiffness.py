"""How firmly clusters are held to the material, where that costs distance from the input."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from warpqem.kernels.placement import STEPS
from warpqem.place.stiffness import (
    COST_POWER,
    MAX_ADDED,
    MAX_ADDED_SHARE,
    MIN_ADDED,
    MIN_STIFFNESS,
    WANDER_TRADE,
    choose_softness,
    cost_of_coherence,
    softer_choices,
)

CLUSTERS = 5
POSITIVE = st.floats(0.0, 1.0, width=32)


def test_choices_are_halves_and_at_last_the_least():
    choices = softer_choices(np.float32([0.8, 0.004]))
    assert choices.shape == (2, STEPS)
    halvings = int(STEPS) - 1
    np.testing.assert_allclose(choices[0, :halvings], 0.8 * 0.5 ** np.arange(halvings))
    np.testing.assert_allclose(choices[1, :3], [0.004, 0.002, MIN_STIFFNESS])
    np.testing.assert_array_equal(choices[:, -1], np.float32(MIN_STIFFNESS))


def descending(values):
    """Errors that fall with the stiffness."""
    return np.sort(values, axis=1)[:, ::-1]


ERRORS = arrays.arrays(np.float32, (CLUSTERS, int(STEPS)), elements=POSITIVE).map(descending)
WANDERS = arrays.arrays(np.float32, (CLUSTERS, int(STEPS)), elements=POSITIVE)
# A hundred times as far with each step: more than any error within the share is worth.
LONG_WAYS = np.float32(1e4) ** np.arange(int(STEPS), dtype=np.float32) * np.ones((CLUSTERS, 1), dtype=np.float32)


@given(ERRORS, POSITIVE)
def test_the_choice_is_the_first_that_adds_no_more_than_its_bound(error, recent):
    area = np.full(CLUSTERS, 0.5)
    chosen = choose_softness(error, np.zeros_like(error), area, np.full(CLUSTERS, recent), np.inf)
    added = error.astype(np.float64) - error[:, -1:].astype(np.float64)
    bound = max(MAX_ADDED * np.float64(np.float32(recent)), 1e-6) ** 2 * 0.5
    row = np.arange(CLUSTERS)
    assert (added[row, chosen] <= bound + 1e-6).all()
    stiffer = chosen > 0
    assert (added[row, chosen - 1][stiffer] > bound - 1e-6).all()


@pytest.mark.parametrize("epsilon", [0.1, 0.5, 20.0])
@given(error=ERRORS, wander=WANDERS)
def test_the_whole_mesh_is_softened_until_stiffness_adds_its_share(epsilon, error, wander):
    area = np.full(CLUSTERS, 1e-3)
    alone = choose_softness(error, wander, area, np.ones(CLUSTERS), np.inf)
    chosen = choose_softness(error, wander, area, np.ones(CLUSTERS), cost_of_coherence(epsilon))
    assert (chosen >= alone).all()
    total = error[np.arange(CLUSTERS), chosen].sum(dtype=np.float64)
    share = MAX_ADDED_SHARE * max(1, epsilon / 0.5) ** COST_POWER
    assert total <= (1 + share) * error[:, -1].sum(dtype=np.float64) + 1e-6


@given(error=ERRORS)
def test_no_mesh_is_softened_beyond_its_share_where_vertices_would_wander_far(error):
    # So large a recent error that no cluster is softened by itself.
    area, recent = np.full(CLUSTERS, 1e-3), np.full(CLUSTERS, 1e4)
    chosen = choose_softness(error, LONG_WAYS, area, recent, 1.0)
    assert len(set(chosen)) == 1
    most = (1 + MAX_ADDED_SHARE) * (error[:, -1].sum(dtype=np.float64) + MIN_ADDED**2 * area.sum())
    assert chosen[0] == 0 or error[:, chosen[0] - 1].sum(dtype=np.float64) + MIN_ADDED**2 * area.sum() > most


@given(error=ERRORS)
def test_a_mesh_whose_vertices_wander_no_further_is_as_soft_as_its_error_asks(error):
    wander, area, recent = np.ones_like(error), np.full(CLUSTERS, 1e-3), np.ones(CLUSTERS)
    chosen = choose_softness(error, wander, area, recent, 1.0)
    assert error[np.arange(CLUSTERS), chosen].sum() <= error[:, -1].sum() * (1 + 1e-6) + 1e-6


@given(error=ERRORS)
def test_a_mesh_that_does_not_move_is_softened_for_its_share_alone(error):
    # So large a recent error that no cluster is softened by itself.
    area, recent = np.full(CLUSTERS, 1e-3), np.full(CLUSTERS, 1e4)
    chosen = [choose_softness(error, wander, area, recent, 1.0) for wander in (np.zeros_like(error), LONG_WAYS)]
    np.testing.assert_array_equal(*chosen)


def test_a_gain_of_error_is_weighed_against_what_vertices_wander_further():
    steps = int(STEPS)
    # Each step gains 1 % of the squared error, all within the share; where nothing wanders further up to the last.
    error = np.repeat((1.01 ** np.arange(steps, 0, -1.0))[None], CLUSTERS, axis=0).astype(np.float32)
    area, recent = np.full(CLUSTERS, 1e-3), np.full(CLUSTERS, 1e3)
    for factor, expected in ((1.01 ** (0.9 / WANDER_TRADE), steps - 1), (1.01 ** (1.1 / WANDER_TRADE), 0)):
        wander = np.repeat((factor ** np.arange(steps))[None], CLUSTERS, axis=0).astype(np.float32)
        assert set(choose_softness(error, wander, area, recent, 1.0)) == {expected}


def test_no_clusters_have_no_choice():
    error = np.empty((0, int(STEPS)), dtype=np.float32)
    assert len(choose_softness(error, error, np.empty(0), np.empty(0, dtype=np.float32), 1.0)) == 0
