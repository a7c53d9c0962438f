"""The stiffness of clusters, chosen by kernels as on the host."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from warpqem.kernels.placement import STEPS
from warpqem.place import softness
from warpqem.place.softness import chosen_stiffness
from warpqem.place.stiffness import softer_choices

CLUSTERS = 700


def measured(seed) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sums (C, 2 S + 1), the choices (C, S) and the recent errors (C,) of some clusters."""
    rng = np.random.default_rng(seed)
    steps = int(STEPS)
    error = 1e-6 * (1 + rng.uniform(0, 0.5, (CLUSTERS, 1)) * 0.5 ** np.arange(steps)) * rng.uniform(0, 1, (CLUSTERS, 1))
    wander = 1e-6 * rng.uniform(0, 1, (CLUSTERS, 1)) * (1 + rng.uniform(0, 0.3)) ** np.arange(steps)
    area = rng.uniform(0, 1e-3, (CLUSTERS, 1))
    choices = softer_choices(rng.uniform(0.001, 0.5, CLUSTERS).astype(np.float32))
    recent = (10.0 ** rng.uniform(-4, -1, CLUSTERS)).astype(np.float32)
    return np.hstack([error, wander, area]).astype(np.float32), choices, recent


@pytest.mark.parametrize(("cost", "softening"), [(np.inf, 0), (np.inf, 3), (1.0, 0), (0.3, 2), (3.8, 0)])
@pytest.mark.parametrize("seed", range(4))
def test_kernels_choose_what_the_host_does(seed, cost, softening, device, monkeypatch):
    sums, choices, recent = measured(seed)
    traits, found = softness.device_traits(device), {}
    for own in (False, True):
        monkeypatch.setattr(softness, "device_traits", lambda _, own=own: replace(traits, own_memory=own))
        there = (wp.array(values, dtype=wp.float32, device=device) for values in (sums, choices))
        chosen = chosen_stiffness(*there, recent, cost, softening)
        found[own] = chosen.stiffness.numpy(), int(chosen.softest.numpy()[0])
    np.testing.assert_array_equal(found[True][0], found[False][0])
    assert found[True][1] == found[False][1] >= softening


def test_vertices_that_do_not_wander_are_softened_for_the_error_alone(device, monkeypatch):
    sums, choices, recent = measured(0)
    sums[:, int(STEPS) : -1] = 0.0
    traits, found = softness.device_traits(device), []
    for own in (False, True):
        monkeypatch.setattr(softness, "device_traits", lambda _, own=own: replace(traits, own_memory=own))
        there = (wp.array(values, dtype=wp.float32, device=device) for values in (sums, choices))
        found.append(chosen_stiffness(*there, recent, 1.0, 0).stiffness.numpy())
    np.testing.assert_array_equal(*found)
