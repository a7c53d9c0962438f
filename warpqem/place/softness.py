"""The stiffness of all clusters, chosen where what decides it was measured."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import warp as wp

from warpqem.kernels import softness as kernels
from warpqem.place.stiffness import (
    MAX_ADDED,
    MAX_ADDED_SHARE,
    MIN_ADDED,
    MIN_WANDER,
    WANDER_TRADE,
    choose_softness,
)
from warpqem.runtime import new_arrays
from warpqem.runtime.device import device_traits
from warpqem.runtime.launches import launch

__all__ = ["ChosenStiffness", "chosen_stiffness"]


@dataclass(frozen=True)
class ChosenStiffness:
    """What clusters are held with, on the device.

    Attributes:
        stiffness: (C,) float32.
        softest: (1,) int32, the least number of a choice that is taken.
    """

    stiffness: wp.array
    softest: wp.array


def chosen_stiffness(
    sums: wp.array, choices: wp.array, recent: np.ndarray, coherence_cost: float, softening: int
) -> ChosenStiffness:
    """What :func:`warpqem.place.stiffness.choose_softness` chooses.

    Args:
        sums: (C, 2 S + 1) float32, see :meth:`warpqem.place.block_placer.BlockPlacer.measure_stiffness`.
        choices: (C, S) float32 on the device.
        recent: (C,) float32, see :func:`warpqem.place.stiffness.choose_softness`.
        coherence_cost: likewise.
        softening: likewise.
    """
    device, (count, steps) = sums.device, choices.shape
    if device_traits(str(device)).own_memory:
        return _chosen_there(sums, choices, recent, _rule(coherence_cost, softening))
    found = sums.numpy()
    error, wander, area = found[:, :steps], found[:, steps : 2 * steps], found[:, 2 * steps]
    chosen = choose_softness(error, wander, area, recent, coherence_cost, softening)
    stiffness = choices.numpy()[np.arange(count), chosen]
    return ChosenStiffness(
        new_arrays.uploaded(stiffness, dtype=wp.float32, device=device),
        new_arrays.uploaded([chosen.min(initial=steps - 1)], dtype=wp.int32, device=device),
    )


def _rule(coherence_cost: float, softening: int) -> kernels.SoftnessRule:
    rule, shares = kernels.SoftnessRule(), math.isfinite(coherence_cost)
    rule.max_added, rule.min_added, rule.least, rule.shares = MAX_ADDED, MIN_ADDED, softening, int(shares)
    cost = coherence_cost if shares else 0.0
    rule.error_factor, rule.wander_weight = 1.0 + MAX_ADDED_SHARE * cost, WANDER_TRADE * cost
    rule.min_wander_squared = MIN_WANDER**2
    return rule


def _chosen_there(sums: wp.array, choices: wp.array, recent: np.ndarray, rule: kernels.SoftnessRule) -> ChosenStiffness:
    """The same by kernels: the host waits for nothing."""
    device, (count, steps) = sums.device, choices.shape
    recent_there = new_arrays.uploaded(recent, dtype=wp.float32, device=device)
    alone, least = (new_arrays.empty(size, dtype=wp.int32, device=device) for size in (count, 1))
    launch(kernels.choose_alone, count, [sums, recent_there, rule], [alone], device=device)
    totals = new_arrays.empty((int(kernels.SLICES), 2 * steps + 2), dtype=wp.float64, device=device)
    launch(kernels.sum_choices, len(totals), [sums, alone], [totals], device=device)
    launch(kernels.choose_together, 1, [totals, rule], [least], device=device)
    stiffness = new_arrays.empty(count, dtype=wp.float32, device=device)
    softest = new_arrays.full(1, steps - 1, dtype=wp.int32, device=device)
    launch(kernels.take_choices, count, [choices, alone, least], [softest, stiffness], device=device)
    return ChosenStiffness(stiffness, softest)
