"""How firmly output vertices are held to the material: the stiffness towards their anchors.

Stiffness keeps vertices from sliding over the surface; it costs distance from the input. By size it costs 3 to 10 % of
the error in the mean, but much more at single vertices: one that stands for a flat cap and for its rim is drawn off the
rim, towards the middle of the cap. So it is bounded for each cluster by what it adds there.
"""

from __future__ import annotations

import math

import numpy as np

from warpqem.kernels.placement import STEPS

__all__ = [
    "MIN_REGULARISATION",
    "MIN_STIFFNESS",
    "choose_softness",
    "cost_of_coherence",
    "softer_choices",
    "stiffness_by_size",
]

# A cluster of so many input vertices is regularised as set. Smaller ones are so less, since they slide less: on 17
# sequences this gains 1 to 5 % of the error at half and a quarter of the faces, where slide has room.
REGULARISED_SIZE = 8.0
# Clusters larger than so many times that size are regularised no more than those.
MAX_RELATIVE_SIZE = 4.0
# Weights of anchors are regularised by the fourth power of the size, as those of small clusters hardly slide at all; no
# more than so many times as set.
MAX_EVENED = 2.0
# The least regularisation that float32 solves safely, of vertices to their anchors and of the weights of anchors to
# equal ones.
MIN_STIFFNESS = 1e-3
MIN_REGULARISATION = 1e-5
# Stiffness may add so much to the root mean square distance of a cluster from its planes, in what the whole mesh has
# when the cluster comes to be. Twice as little, vertices slide twice as far for 1 % of the error.
MAX_ADDED = 1.5
# Distances below this, in diagonals, are all the same: ten times what float32 resolves.
MIN_ADDED = 1e-6
# Stiffness may add so much to the mean squared distance of a whole mesh. It mostly adds 6 to 20 %, and up to 74 % where
# deformation travels over the surface, as wrinkles do: there vertices have to go along.
MAX_ADDED_SHARE = 0.15
# A whole mesh is softened on where one percent less of its error costs less than 1 / 0.06 = 17 percent more of what its
# vertices wander. Where parts of a mesh move against each other they may wander less, the softer they are held: an
# anchor of vertices on both sides follows neither.
WANDER_TRADE = 0.06
# Root mean square, in diagonals, of what a vertex wanders where nothing does. There a softer mesh would have a 4 %
# larger largest distance for its error.
MIN_WANDER = 1e-5
# The stiffness at coherence one half, which these are for. Who asks for more gets it: both grow with a power of the
# stiffness, so that at coherence 1 nothing is softened (there stiffness adds two to three times the squared distance,
# and the share is 3.8).
SHARED_STIFFNESS = 0.5
COST_POWER = 0.6


def stiffness_by_size(size: np.ndarray, epsilon: float, regularisation: float) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness towards the anchor, and of the anchor's weights towards equal ones: (C,) float32 each.

    Args:
        size: (C,) int, input vertices of each cluster.
        epsilon: the first, of a cluster of ``REGULARISED_SIZE`` vertices, relative to its quadric.
        regularisation: the second, likewise.
    """
    relative = size / REGULARISED_SIZE
    stiffness = np.maximum(epsilon * np.sqrt(np.minimum(relative, MAX_RELATIVE_SIZE)), MIN_STIFFNESS)
    evened = regularisation * np.minimum(relative**4, MAX_EVENED)
    return stiffness.astype(np.float32), evened.astype(np.float32)


def cost_of_coherence(epsilon: float) -> float:
    """What coherence may cost, relative to what it may at coherence one half and less.

    Args:
        epsilon: stiffness as it is set, see :func:`stiffness_by_size`.
    """
    return max(1.0, epsilon / SHARED_STIFFNESS) ** COST_POWER


def softer_choices(stiffness: np.ndarray) -> np.ndarray:
    """(C, STEPS) float32: a stiffness, half of it and so on, and at last the least."""
    steps = int(STEPS)
    choices = stiffness[:, None] * np.float32(0.5) ** np.arange(steps, dtype=np.float32)
    choices = np.maximum(choices, np.minimum(stiffness, np.float32(MIN_STIFFNESS))[:, None])
    choices[:, -1] = np.minimum(stiffness, np.float32(MIN_STIFFNESS))
    return choices.astype(np.float32)


def choose_softness(
    error: np.ndarray,
    wander: np.ndarray,
    area: np.ndarray,
    recent: np.ndarray,
    coherence_cost: float,
    softening: int = 0,
) -> np.ndarray:
    """(C,) int, the first of the choices of each cluster that adds little to its distance from the input.

    Args:
        error: (C, S) area times squared distance with each choice, the softest last.
        wander: (C, S) squared distance of the vertex from where it is in the mean, beside its anchor.
        area: (C,) what planes weigh.
        recent: (C,) what the mesh had come to when the cluster came to be, in diagonals.
        coherence_cost: see :class:`warpqem.place.clusters.PlaceSettings`.
        softening: choices that come before are none.
    """
    bound = np.maximum(MAX_ADDED * recent.astype(np.float64), MIN_ADDED)
    fits = error <= error[:, -1:] + (bound**2 * area)[:, None]
    fits[:, -1] = True
    chosen: np.ndarray = np.maximum(np.argmax(fits, axis=1), softening)
    if math.isinf(coherence_cost) or not len(chosen):
        return chosen
    choices = [np.maximum(chosen, least) for least in range(softening, error.shape[1])]
    errors = MIN_ADDED**2 * area.sum(dtype=np.float64) + _totals(error, choices)
    within = errors <= (1.0 + MAX_ADDED_SHARE * coherence_cost) * errors[-1]
    # Vertices that are as soft as can be in any case say nothing of the others.
    others = chosen < error.shape[1] - 1
    wanders = _totals(wander[others], [choice[others] for choice in choices])
    if wanders[-1] <= others.sum() * MIN_WANDER**2:
        return choices[int(np.argmax(within))]
    # Of clusters without area all errors are zero.
    logarithms = [np.log(np.maximum(values, np.finfo(np.float64).tiny)) for values in (errors, wanders)]
    cost = np.dot([1.0, WANDER_TRADE * coherence_cost], logarithms)
    return choices[int(np.argmin(np.where(within, cost, np.inf)))]


def _totals(values: np.ndarray, choices: list[np.ndarray]) -> np.ndarray:
    """(n,) sums over all clusters of values (C, S) at each of n choices (C,)."""
    row = np.arange(len(values))
    return np.array([values[row, choice].sum(dtype=np.float64) for choice in choices])
