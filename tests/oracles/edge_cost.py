"""The cost of an edge collapse over frames, from the quadrics' definition."""

import numpy as np

from tests.oracles.quadrics import minimiser, shifted

MIDDLE_REGULARISATION = 1e-5
LENGTH_COST = 1e-8


def merged(qu, qv, pu, pv, anchor):
    """Sum of the quadrics of both ends about the point at ``anchor`` along the edge."""
    d = pv - pu
    return shifted(qu, anchor * d) + shifted(qv, (anchor - 1) * d)


def edge_anchor(quadrics_u, quadrics_v, points_u, points_v) -> float:
    """``lambda`` in [0, 1] with the least sum over frames at ``(1 - lambda) p_u + lambda p_v``, by three samples.

    The sum is a parabola in lambda, so its values at 0, 1/2 and 1 say all; the regularisation towards the middle is
    added to it.
    """

    def total(s):
        value = 0.0
        for qu, qv, pu, pv in zip(quadrics_u, quadrics_v, points_u, points_v, strict=True):
            value += merged(qu, qv, pu, pv, s).c
            value += MIDDLE_REGULARISATION * np.trace(qu.A + qv.A) * ((pv - pu) @ (pv - pu)) * (s - 0.5) ** 2
        return value

    low, middle, high = total(0.0), total(0.5), total(1.0)
    curvature = 2 * (low + high - 2 * middle)
    slope = high - low - curvature
    return float(np.clip(-slope / (2 * curvature), 0, 1))


def edge_cost(quadrics_u, quadrics_v, points_u, points_v, anchor, epsilon, at_anchor=False):
    """(cost, mean squared error, positions (K, 3)) of the collapse."""
    total = area = spread = 0.0
    positions = []
    for qu, qv, pu, pv in zip(quadrics_u, quadrics_v, points_u, points_v, strict=True):
        q = merged(qu, qv, pu, pv, anchor)
        x = np.zeros(3) if at_anchor else minimiser(q, epsilon)
        positions.append(pu + anchor * (pv - pu) + x)
        total += q(x)
        area += np.trace(q.A)
        spread += np.trace(q.A) * ((pv - pu) @ (pv - pu))
    return total + LENGTH_COST * spread, total / area, np.array(positions)
