"""Samples of a moving surface, drawn more densely where it was found to be far from another one."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["Draws", "SampleDraws"]

# Multiples of the golden ratio are spread evenly over the numbers from 0 to 1, however many of them are taken.
GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
# Parts of the surface that are told apart, each a run of faces along a space-filling curve: with four times as many,
# a part has too few samples to learn from, and the error of an ear that is lost is twice as large.
REGIONS = 1024
# This share of the samples is drawn in proportion to area whatever was found, so that no sample weighs more than two,
# and no figure has more than about twice the variance.
UNIFORM_SHARE = 0.5
# What a part counts before it has samples: one that is like the mean of all.
PRIOR_SAMPLES = 1.0
# Bits of a Morton code for each axis.
CURVE_BITS = 10

Doubles = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Draws:
    """Samples of n frames, S in each; or of n meshes.

    Attributes:
        face: (n, S) faces, counted from the first one of the mesh.
        place: (n, S, 2) barycentric coordinates of their second and third corner.
        weight: (n, S), 1 in the mean of all draws: the mean of a value times its weight is that over the area.
    """

    face: Ints
    place: Doubles
    weight: Doubles


@functools.cache
def _spread_bits() -> Ints:
    """Each number of a curve's bits with two empty bits behind each of them."""
    number = np.arange(2**CURVE_BITS)
    spread = np.zeros_like(number)
    for bit in range(CURVE_BITS):
        spread |= (number >> bit & 1) << 3 * bit
    return spread


@functools.lru_cache(maxsize=8)
def _numbers(key: tuple[int, ...], count: int) -> tuple[Doubles, Doubles]:
    """The place of each of so many samples among the strata, and its second number; meshes of one frame share them."""
    random, stratum = np.random.default_rng(list(key)), np.arange(count, dtype=np.float64)
    place: Doubles = stratum + random.random(count)
    second: Doubles = (random.random() + GOLDEN * stratum) % 1.0
    return place, second


def _along_curve(points: Doubles, first: Ints, mesh: Ints) -> Ints:
    """The order of points (N, 3) along a Morton curve, mesh after mesh (N,); ``first`` (M,) are those of each."""
    low, high = (bound.reduceat(points, first, axis=0) for bound in (np.minimum, np.maximum))
    extent = (high - low).max(axis=1)
    side = 2**CURVE_BITS
    # Off any simple fraction of the extent: points of a regular mesh are in the same cells wherever it stands.
    scale = np.divide(side - 1, extent, out=np.zeros_like(extent), where=extent > 0)
    cell = ((points - low[mesh]) * scale[mesh, None] + np.where(extent > 0, GOLDEN, 0.0)[mesh, None]).astype(np.int64)
    spread = _spread_bits()[cell]
    return np.argsort(spread[:, 0] | spread[:, 1] << 1 | spread[:, 2] << 2 | mesh << 3 * CURVE_BITS, kind="stable")


class SampleDraws:
    """Draws samples of a surface, frame after frame, and learns from their distances where the next ones should lie.

    Several meshes in one frame are drawn from at once, from each as from it alone.

    A mean over the surface has the least variance where samples are as dense as the root mean square of the value
    (Neyman, "On the two different aspects of the representative method", 1934): here of the squared distance, in each
    part of the surface, relative to the frame's. The mean is unbiased, as the density of a frame depends on samples of
    other draws alone.

    Args:
        corners: (N, 3, 3) corners of the faces in the first frame.
        seed: seed of the samples.
        side: 0 or 1, so that two surfaces have different samples.
        first_face: (M+1,) where the faces of each of several meshes begin, and the last ones end; None for one mesh.
    """

    def __init__(self, corners: Doubles, seed: int, side: int, first_face: Ints | None = None) -> None:
        self._key = (seed, side)
        self._first = np.array([0, len(corners)]) if first_face is None else first_face
        counts, first = np.diff(self._first), self._first[:-1]
        mesh = np.repeat(np.arange(len(counts)), counts)
        self._order = _along_curve(corners.mean(axis=1), first, mesh)
        regions = np.minimum(counts, REGIONS)
        # Of each place in the order, and of each face.
        own = (np.arange(len(corners)) - first[mesh]) * regions[mesh] // counts[mesh]
        self._place_region = own + (np.cumsum(regions) - regions)[mesh]
        self._face_region = np.empty_like(self._place_region)
        self._face_region[self._order] = self._place_region
        self._sum, self._count = np.zeros(regions.sum()), np.zeros(regions.sum())

    def learn(self, draws: Draws, distance: Doubles) -> None:
        """Take in the distances (n, S) of samples, of frames or meshes."""
        power = distance**4
        mean = (power * draws.weight).mean(axis=1, keepdims=True)
        relative = np.divide(power, mean, out=np.ones_like(power), where=mean > 0)
        region = self._face_region[draws.face + self._first_of(draws.face)].ravel()
        self._sum += np.bincount(region, relative.ravel(), len(self._sum))
        self._count += np.bincount(region, minlength=len(self._sum))

    def draw(self, areas: Doubles, frames: Sequence[int], count: int, *, pilot: bool = False) -> Draws:
        """So many samples of frames with face areas (n, N), or of each mesh; those of a ``pilot`` are others.

        The share of the samples before a face, in the order of the curve, is drawn in as many strata as there are
        samples. What is left of it within the face is the first number of the square-root map of Osada et al., "Shape
        Distributions" (2002), equation 1, so that the strata go on within the faces. The second goes on by the golden
        ratio from one sample to the next, from a random start, so that the two fill the faces evenly, as in Roberts,
        "The unreasonable effectiveness of quasirandom sequences" (2018): 4000 samples then say as much as 20000 with
        random numbers.
        """
        areas = areas[:, self._order]
        density = np.sqrt((self._sum + PRIOR_SAMPLES) / (self._count + PRIOR_SAMPLES))[self._place_region]
        parts = [slice(*ends) for ends in itertools.pairwise(self._first.tolist())]
        # No matrix product: its bits depend on the number of threads.
        weighted = areas * density
        mean = [weighted[:, part].sum(axis=1) / areas[:, part].sum(axis=1) for part in parts]
        seed, side = self._key
        rows = list(itertools.product(range(len(areas)), range(len(parts))))
        place = np.empty((len(rows), count), dtype=np.int64)
        first, second, weight = (np.empty(place.shape) for _ in range(3))
        for row, (frame, mesh) in enumerate(rows):
            key, part = (seed, int(frames[frame]), side), parts[mesh]
            strata, second[row] = _numbers((*key, 1) if pilot else key, count)
            relative = UNIFORM_SHARE + (1.0 - UNIFORM_SHARE) / mean[mesh][frame] * density[part]
            share = areas[frame, part] * relative
            total = np.cumsum(share)
            drawn = strata * (total[-1] / count)
            # Rounding may put the last one beyond the last face with an area.
            last = int(np.searchsorted(total, total[-1]))
            own = np.minimum(np.searchsorted(total, drawn, side="right"), last)
            place[row] = own
            first[row] = (total[own] - drawn) / share[own]
            weight[row] = relative[own]
        root = np.sqrt(np.clip(1.0 - first, 0.0, 1.0))
        start = self._first_of(place)
        face = self._order[place + start] - start
        return Draws(face, np.stack([root * (1.0 - second), root * second], axis=-1), 1.0 / weight)

    def _first_of(self, rows: Ints) -> Ints:
        """(n, 1) the first face of the mesh of each of n rows."""
        return np.resize(self._first[:-1], len(rows))[:, None]
