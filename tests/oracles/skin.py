"""The fit of a skinned vertex (simplification of articulated meshes, Landreneau & Schaefer 2009), from its formula.

``E(v, a) = sum_j p_j^T Q_j p_j`` with ``p_j = sum_k a_k M_k^j v``: a quadric is ``(p - y)^T H (p - y)`` here, and both
solves are pulled towards where they start.
"""

from itertools import combinations

import numpy as np


def moved(transforms, rest):
    """(P, J, 3), where each joint alone takes the rest position in each pose."""
    return transforms[..., :3] @ rest + transforms[..., 3]


def energy(transforms, stiffness, goal, rest, weights):
    """``E(v, a)``."""
    away = np.einsum("k,pki->pi", weights, moved(transforms, rest)) - goal
    return float(np.einsum("pi,pij,pj->", away, stiffness, away))


def best_position(transforms, stiffness, goal, weights, start, regularisation):
    """The first sub-problem: the position with the weights fixed, a 3x3 system."""
    matrix, right = np.zeros((3, 3)), np.zeros(3)
    for pose, h, y in zip(transforms, stiffness, goal, strict=True):
        blend = np.einsum("k,kij->ij", weights, pose)
        linear, shift = blend[:, :3], blend[:, 3]
        matrix += linear.T @ h @ linear
        right += linear.T @ h @ (y - shift)
    soft = regularisation * np.trace(matrix) / 3
    return np.linalg.solve(matrix + soft * np.eye(3), right + soft * start)


def best_weights(transforms, stiffness, goal, rest, start, regularisation, most=None):
    """The second: the weights with the position fixed, sum one, none below zero, by trying every set of joints."""
    away = moved(transforms, rest) - goal[:, None]
    gram = np.einsum("pki,pij,plj->kl", away, stiffness, away)
    count = len(gram)
    soft = regularisation * np.trace(gram) / count
    gram, linear = gram + soft * np.eye(count), soft * start
    best = (np.inf, start)
    for size in range(1, (most or count) + 1):
        for used in map(list, combinations(range(count), size)):
            # Lagrange: G a - linear = m, sum a = 1.
            system = np.block([[gram[np.ix_(used, used)], -np.ones((size, 1))], [np.ones((1, size)), np.zeros((1, 1))]])
            own = np.zeros(count)
            own[used] = np.linalg.solve(system, np.append(linear[used], 1.0))[:size]
            value = own @ gram @ own - 2 * linear @ own
            if (own >= 0).all() and value < best[0]:
                best = (value, own)
    return best[1]
