"""Least squares: values at the corners of the output that fit the input's at the samples.

The normal equations are those of piecewise linear functions on triangles. Scaled by their diagonal their eigenvalues
lie between those of one element matrix scaled by its own (Wathen 1987, "Realistic eigenvalue bounds for the Galerkin
mass matrix"), 1/2 and 2 or near to it, on any mesh. So the Chebyshev iteration needs no dot products, and the same
number of steps everywhere: nothing depends on threads.
"""

from __future__ import annotations

import functools

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.attribute_fit.partners import SAMPLES, Partners
from warpqem.kernels import attribute_fit as kernels
from warpqem.place.cluster_rows import group_rows
from warpqem.runtime import new_arrays
from warpqem.runtime.device import device_traits, device_turn
from warpqem.runtime.part_launches import FIRST_ITEM, launch_in_parts

__all__ = ["corner_fits", "fit_values", "misfits"]

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]

# Means over the samples of the squared weight of a corner, and of the product of those of two: the same of all rules
# that are exact to degree 2.
OWN = float((SAMPLES[:, 0] ** 2).mean())
OTHER = float((SAMPLES[:, 0] * SAMPLES[:, 1]).mean())
# Eigenvalues of an element matrix scaled by its diagonal.
LOW, HIGH = (OWN - OTHER) / OWN, (OWN + 2 * OTHER) / OWN
# Saad 2003, "Iterative methods for sparse linear systems", algorithm 12.1.
MIDDLE, HALF = (HIGH + LOW) / 2, (HIGH - LOW) / 2
# Each step divides the error by three: this many leave two millionths of it.
STEPS = 12


def misfits(
    partners: Partners, corner_element: Ints, values: Floats, corner_start: Ints, start: Floats
) -> npt.NDArray[np.float64]:
    """What start values miss, (N', 3, C): for each corner the mean over the samples of its weight times the misfit.

    Args:
        partners: of the samples.
        corner_element: (N, 3) int32, which of the values each corner of the input has.
        values: (E, C) float64, of the input.
        corner_start: (N', 3) int32, which start value each corner of the output has.
        start: (R, C) float64.
    """
    face_count, channels = len(corner_start), values.shape[1]
    with device_turn(partners.device):
        misfit = new_arrays.zeros((3 * face_count, channels), dtype=wp.float64, device=partners.device)
        launch_in_parts(
            kernels.sum_misfits,
            (face_count, channels),
            [
                FIRST_ITEM,
                partners.face,
                partners.weight,
                partners.samples_on_device,
                new_arrays.uploaded(corner_element.ravel(), dtype=wp.int32, device=partners.device, copy=False),
                new_arrays.uploaded(values, dtype=wp.float64, device=partners.device, copy=False),
                new_arrays.uploaded(corner_start.ravel(), dtype=wp.int32, device=partners.device),
                new_arrays.uploaded(start, dtype=wp.float64, device=partners.device),
            ],
            [misfit],
            device=partners.device,
        )
        found: Floats = misfit.numpy().reshape(face_count, 3, channels)
    return found


def corner_fits(misfit: Floats) -> Floats:
    """The change (N', 3, C) at the corners of each face that fits its own samples best, from what the start misses."""
    # The inverse of the element matrix.
    mean = misfit.sum(axis=1, keepdims=True)
    return (misfit - OTHER / (OWN + 2 * OTHER) * mean) / (OWN - OTHER)


def fit_values(
    partners: Partners, misfit: Floats, corner_row: Ints, free: npt.NDArray[np.bool_], steps: int = STEPS
) -> Floats:
    """The change (R, C) of the values at the corners that fits all samples best.

    Args:
        partners: of the samples.
        misfit: (N', 3, C), see :func:`misfits`.
        corner_row: (N', 3) int32, which of the R values each corner of the output has.
        free: (R,) bool, values that may change.
        steps: of the iteration.
    """
    device, channels, row_count = partners.device, misfit.shape[2], len(free)
    with device_turn(device):
        corner = new_arrays.uploaded(corner_row.ravel(), dtype=wp.int32, device=device)
        may_change = new_arrays.uploaded(free, dtype=wp.int32, device=device)
        right = new_arrays.uploaded(misfit.reshape(-1, channels), dtype=wp.float64, device=device, copy=False)
        change = new_arrays.zeros((row_count, channels), dtype=wp.float64, device=device)
        if device_traits(device).in_order:
            launch_in_parts(
                kernels.solve_channel,
                channels,
                [
                    FIRST_ITEM,
                    corner,
                    partners.area_on_device,
                    may_change,
                    OWN,
                    OTHER,
                    right,
                    1.0 / MIDDLE,
                    new_arrays.uploaded(_schedule(steps), dtype=wp.float64, device=device),
                    new_arrays.zeros((channels, 4, row_count), dtype=wp.float64, device=device),
                ],
                [change],
                device=device,
            )
        else:
            unknowns = kernels.Unknowns()
            unknowns.corner, unknowns.area, unknowns.free = corner, partners.area_on_device, may_change
            unknowns.own, unknowns.other = OWN, OTHER
            _solve_by_unknowns(unknowns, corner_row, right, change, steps, device)
        found: Floats = change.numpy()
    return found


def _solve_by_unknowns(
    unknowns: kernels.Unknowns, corner_row: Ints, right: wp.array, change: wp.array, steps: int, device: str
) -> None:
    """The same with a thread for each unknown, which a device without order of its threads has to give its sums to."""
    shape = change.shape
    adjacent, start = group_rows(corner_row.ravel(), shape[0])
    unknowns.adjacency_start = new_arrays.uploaded(start, dtype=wp.int32, device=device)
    unknowns.adjacent_corner = new_arrays.uploaded(adjacent, dtype=wp.int32, device=device)
    residual, direction, following = (new_arrays.empty(shape, dtype=wp.float64, device=device) for _ in range(3))
    launch_in_parts(
        kernels.start_solution,
        shape,
        [FIRST_ITEM, unknowns, right, 1.0 / MIDDLE],
        [residual, change, direction],
        device=device,
    )
    for turn, step in _schedule(steps):
        launch_in_parts(
            kernels.improve_solution,
            shape,
            [FIRST_ITEM, unknowns, direction, turn, step],
            [residual, change, following],
            device=device,
        )
        direction, following = following, direction


@functools.cache
def _schedule(steps: int) -> Floats:
    """How much of the last direction each step takes, and of the scaled residual (steps, 2)."""
    ratio, rows = HALF / MIDDLE, []
    for _ in range(steps):
        following = 1.0 / (2.0 * MIDDLE / HALF - ratio)
        rows.append((following * ratio, 2.0 * following / HALF))
        ratio = following
    return np.array(rows)
