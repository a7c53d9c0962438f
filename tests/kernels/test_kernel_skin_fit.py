"""The two solves of a skinned vertex against their formulas."""

import numpy as np
import pytest
import warp as wp

from tests.oracles import skin as oracle
from tests.support.meshes import rotation
from warpqem.skinning.fit_problem import POSITION_REGULARISATION, WEIGHT_REGULARISATION, CandidateRows, SkinFit

JOINTS, POSES, VERTICES = 5, 6, 12


def problem(seed):
    """Transforms (P, J, 3, 4), stiffness (C, P, 3, 3), goals (P, C, 3), rest positions (C, 3), weights (C, J)."""
    rng = np.random.default_rng(seed)
    transforms = np.zeros((POSES, JOINTS, 3, 4))
    for pose in range(POSES):
        for joint in range(JOINTS):
            transforms[pose, joint, :, :3] = rotation(rng.normal(size=3), rng.uniform(-1, 1))
            transforms[pose, joint, :, 3] = rng.normal(scale=0.2, size=3)
    planes = rng.normal(size=(VERTICES, POSES, 4, 3))
    stiffness = np.einsum("cpni,cpnj->cpij", planes, planes)
    rest, weights = rng.uniform(-0.5, 0.5, (VERTICES, 3)), rng.dirichlet(np.ones(JOINTS), VERTICES)
    skinned = np.einsum("ck,pkij,cj->pci", weights, transforms[..., :3], rest)
    skinned += np.einsum("ck,pki->pci", weights, transforms[..., 3])
    return transforms, stiffness, skinned + rng.normal(scale=0.2, size=skinned.shape), rest, weights


def solved(given, influences, device):
    """Rest positions, weights (C, J), E before and after."""
    transforms, stiffness, goal, rest, weights = given
    start = np.arange(VERTICES + 1) * JOINTS
    rows = CandidateRows(start, np.tile(np.arange(JOINTS), VERTICES), weights.ravel())
    fit = SkinFit(transforms, rows, rest, goal, None, 1.0, device)
    arrays = [wp.array(stiffness, dtype=wp.mat33d, device=device), wp.array(goal, dtype=wp.vec3d, device=device)]
    rest, weight, before, after = fit._solve_batch(slice(0, VERTICES), *arrays, influences)
    return rest, weight.reshape(VERTICES, JOINTS), before, after


@pytest.mark.parametrize("seed", range(3))
def test_one_round_is_the_best_position_then_the_best_weights(seed, device, monkeypatch):
    monkeypatch.setattr("warpqem.skinning.fit_problem.ROUNDS", 1)
    given = transforms, stiffness, goal, rest, weights = problem(seed)
    found_rest, found_weights, before, after = solved(given, JOINTS, device)
    for c in range(VERTICES):
        of_vertex = transforms, stiffness[c], goal[:, c]
        position = oracle.best_position(*of_vertex, weights[c], rest[c], POSITION_REGULARISATION)
        np.testing.assert_allclose(found_rest[c], position, atol=1e-9)
        expected = oracle.best_weights(*of_vertex, position, weights[c], WEIGHT_REGULARISATION)
        np.testing.assert_allclose(found_weights[c], expected, atol=1e-7)
        assert before[c] == pytest.approx(oracle.energy(*of_vertex, rest[c], weights[c]), rel=1e-9)
        assert after[c] == pytest.approx(oracle.energy(*of_vertex, found_rest[c], found_weights[c]), rel=1e-9)
    # Some weights meet their bound, or the constraint would not be tested.
    assert (found_weights == 0).any()


def test_alternating_lowers_the_energy(device):
    _, _, before, after = solved(problem(7), JOINTS, device)
    assert (after < before).all()


def test_no_more_influences_than_asked_for_and_a_sum_of_one(device):
    _, weights, _, _ = solved(problem(8), 2, device)
    assert ((weights > 0).sum(axis=1) <= 2).all()
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-12)
