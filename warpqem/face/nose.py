"""The middle of a face and its nose, which everything else is measured by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpqem.face.relief import Relief, make_relief
from warpqem.face.walks import from_chord, walk_tilted, walk_to_extremum

__all__ = ["FaceUnits", "find_units"]

# Samples across the larger side of the first, coarse relief.
COARSE = 256
# Smoothing of that relief, in samples.
COARSE_SIGMA = 1.5
# How far from the middle of the surface its plane of symmetry may lie, as part of the width.
MIDDLE_SEARCH = 0.12
# The face is compared with its mirror image this far to each side, as part of the width.
MIDDLE_REACH = 0.25
# Half a nose's width, as part of a surface's; a nose stands out from what is that far beside it, and by at least
# this part of the surface's height.
NOSE_HALF_WIDTH, MIN_DROP = 0.07, 0.02
# An extremum on the ridge of the nose stands out by this part of the surface's height.
RIDGE_PROMINENCE = 0.004
# A nose is no shorter than this part of the surface, or it is the wrong bump (and the face around it huge).
MIN_NOSE = 0.06
# From a first guess of the root of the nose, the chord to the tip begins this far up the forehead, in noses.
FOREHEAD = 0.35


@dataclass(frozen=True)
class FaceUnits:
    """Coordinates in which faces are alike: the origin is the tip of the nose, a nose's length is one.

    Attributes:
        axes: (3, 3) float64, unit vectors to the person's left, up and forward.
        tip: (3,) float64, the tip of the nose.
        nose: length of the nose, in the mesh's unit.
    """

    axes: np.ndarray
    tip: np.ndarray
    nose: float

    def local(self, points: np.ndarray) -> np.ndarray:
        """Left, up and forward of points (..., 3), in noses."""
        return (points - self.tip) @ self.axes.T / self.nose

    def local_vectors(self, vectors: np.ndarray) -> np.ndarray:
        """The same for vectors (..., 3)."""
        return vectors @ self.axes.T / self.nose


def find_units(points: np.ndarray, faces: np.ndarray, axes: np.ndarray, samples: int = COARSE) -> FaceUnits | None:
    """Find the nose of a face that looks along ``axes[2]``.

    Args:
        points: (V, 3) float64.
        faces: (N, 3) int, what can be seen of the face.
        axes: (3, 3), unit vectors to the left, up and forward.
        samples: across the larger side of the relief that is looked at.

    Returns:
        None where nothing looks like a nose.
    """
    used = np.unique(faces)
    turned = points @ axes.T
    low, high = turned[used].min(axis=0), turned[used].max(axis=0)
    extent = high - low
    pixel = float(max(extent[0], extent[1])) / samples
    if pixel <= 0.0:
        return None
    relief = make_relief(turned, faces, (low[0], low[1]), (high[0], high[1]), pixel).smoothed(COARSE_SIGMA * pixel)
    middle = _middle(relief)
    profile = relief.along_column(relief.left(middle), pixel)
    tip = _tip(relief, middle, profile, MIN_DROP * extent[1])
    if tip is None:
        return None
    least = RIDGE_PROMINENCE * extent[1]
    top = walk_tilted(profile, tip, len(profile) - 1, -1.0, least, pixel)
    foot = walk_tilted(profile, tip, 0, -1.0, least, pixel)
    if top is None or foot is None:
        return None
    lip = walk_to_extremum(profile, foot.at, 0, 1.0, least / 4)
    bottom = from_chord(profile, tip, foot.at if lip is None else lip.at, -1.0, pixel)
    guess = top.at - (foot if bottom is None else bottom).at
    brow = min(top.at + round(FOREHEAD * guess), int(np.flatnonzero(np.isfinite(profile)).max()))
    root = from_chord(profile, tip, brow, -1.0, pixel)
    if bottom is None or root is None or root.at - bottom.at < MIN_NOSE * samples:
        return None
    place = np.array([relief.left(middle), relief.up(tip), profile[tip]])
    return FaceUnits(axes, place @ axes, (root.at - bottom.at) * pixel)


def _middle(relief: Relief) -> int:
    """The column about which the relief is most like its mirror image."""
    width = relief.height.shape[1]
    reach = max(2, round(MIDDLE_REACH * width))
    spread = round(MIDDLE_SEARCH * width)
    columns = np.arange(max(reach, width // 2 - spread), min(width - reach, width // 2 + spread + 1))
    if not len(columns):
        return width // 2
    offsets = np.arange(1, reach)
    unlike = []
    for column in columns:
        both = relief.inside[:, column + offsets] & relief.inside[:, column - offsets]
        difference = np.abs(relief.height[:, column + offsets] - relief.height[:, column - offsets])[both]
        unlike.append(np.mean(np.minimum(difference, 3.0 * np.median(difference))) if len(difference) else np.inf)
    return int(columns[int(np.argmin(unlike))])


def _tip(relief: Relief, middle: int, profile: np.ndarray, least: float) -> int | None:
    """The peak on the midline that stands out most from what is beside it."""
    beside = max(2, round(NOSE_HALF_WIDTH * relief.height.shape[1]))
    if middle < beside or middle + beside >= relief.height.shape[1]:
        return None
    sides = relief.height[:, [middle - beside, middle + beside]]
    drop = profile - sides.mean(axis=1)
    peak = np.zeros(len(profile), dtype=bool)
    peak[2:-2] = (profile[2:-2] >= profile[1:-3]) & (profile[2:-2] >= profile[3:-1])
    peak &= np.isfinite(drop) & relief.inside[:, [middle - beside, middle + beside]].all(axis=1)
    if not peak.any():
        return None
    best = int(np.where(peak, drop, -np.inf).argmax())
    return best if drop[best] >= least else None
