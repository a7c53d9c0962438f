"""Where the lips meet and where that line ends: by the motion of the lips where they part, else by the relief."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpqem.face.relief import Relief
from warpqem.face.spots import Missing, Spot, trust

__all__ = ["LipMotion", "find_parting", "follow_dent"]

# Lips lie between these heights, in noses from the foot of the nose, and this far to the sides of the midline.
LIPS_FROM, LIPS_TO, MIDDLE = 0.1, 0.85, 0.12
# Vertices this far above and below a line tell how it opens.
LIP_BAND = 0.06
# Lips that part by this much, in noses, tell where they meet.
MIN_PARTING = 0.05
# Only what lies this close to the relief belongs to the outside of the lips.
OUTSIDE = 0.06
# The line is followed in such steps, up to the widest mouth, and looked for that far above and below.
STEP, WIDEST, FOLLOW = 0.02, 0.9, 0.04
# Mouths end before this distance. The line ends where the lips part by less than this share of the middle, over what
# the skin beyond stretches, or where its dent is less than that share.
BEYOND = 0.65
PARTING_END, DENT_END = 0.15, 0.35
# A dent is measured from this far above and below.
DENT_REACH = 0.09
# The dent's usual depth is that within this distance of the midline.
DENT_MIDDLE = 0.25


@dataclass(frozen=True)
class LipMotion:
    """How the lips part.

    Attributes:
        place: (n, 3) float64, vertices on the outside of the mouth, in noses.
        rise: (F, n) float64, their upward motion, apart from the head's.
        up: height of the contact on the midline.
        parting: by how much the lips part there at most.
    """

    place: np.ndarray
    rise: np.ndarray
    up: float
    parting: float

    @property
    def confidence(self) -> float:
        """0 to 1."""
        return self.parting / (self.parting + MIN_PARTING)

    def mirrored(self) -> LipMotion:
        """Left and right exchanged."""
        return LipMotion(self.place * (-1.0, 1.0, 1.0), self.rise, self.up, self.parting)

    def corner(self, relief: Relief, contact: float) -> Spot | Missing:
        """Follow the line to where the lips part no more than the skin beyond stretches."""
        ups, parts = [contact], []
        for left in np.arange(0.0, WIDEST, STEP):
            chosen = np.abs(self.place[:, 0] - left) < 2.0 * STEP
            place, rise = self.place[chosen], self.rise[:, chosen]
            options = np.arange(ups[-1] - FOLLOW, ups[-1] + FOLLOW + 1e-9, FOLLOW / 4)
            found = [_parting(place, rise, option) for option in options]
            best = int(np.argmax(found))
            parts.append(found[best] / self.parting)
            # Where nothing parts there is no line to follow.
            ups.append(float(options[best]) if parts[-1] > PARTING_END else ups[-1])
        beyond = float(np.median(parts[round(BEYOND / STEP) :]))
        ended = np.flatnonzero(np.array(parts) < beyond + PARTING_END * (1.0 - beyond))
        if not len(ended) or ended[0] == 0:
            return Missing("the lips do not part along a line that ends")
        end, up = STEP * float(ended[0]), ups[int(ended[0])]
        height = float(relief.height[relief.row(up), relief.column(end)])
        return Spot(end, up, height, self.confidence)


def find_parting(place: np.ndarray, rise: np.ndarray, relief: Relief, nose_bottom: float) -> LipMotion | None:
    """Where the lips part in motion; None if they hardly do.

    Args:
        place: (n, 3) vertices in noses.
        rise: (F, n) upward motion, apart from the head's.
        relief: the face in noses.
        nose_bottom: height of the foot of the nose.
    """
    rows = np.clip(np.rint((place[:, 1] - relief.origin[1]) / relief.pixel).astype(int), 0, len(relief.height) - 1)
    columns = np.rint((place[:, 0] - relief.origin[0]) / relief.pixel).astype(int)
    columns = np.clip(columns, 0, relief.height.shape[1] - 1)
    around = (place[:, 1] < nose_bottom) & (place[:, 1] > nose_bottom - 1.2) & (np.abs(place[:, 0]) < 1.2)
    around &= np.abs(relief.height[rows, columns] - place[:, 2]) < OUTSIDE
    place, rise = place[around], rise[:, around]
    middle = np.abs(place[:, 0]) < MIDDLE
    options = np.arange(nose_bottom - LIPS_TO, nose_bottom - LIPS_FROM, relief.pixel)
    parts = np.array([_parting(place[middle], rise[:, middle], option) for option in options])
    if not len(parts) or parts.max() < MIN_PARTING:
        return None
    # Lips that lie on each other leave a range of lines between them: its middle.
    best = np.flatnonzero(parts >= 0.98 * parts.max())
    return LipMotion(place, rise, float(options[best].mean()), float(parts.max()))


def _parting(place: np.ndarray, rise: np.ndarray, up: float) -> float:
    """By how much what is above a line parts from what is below, in the frame where it does most.

    Skin that stretches evenly does not part: what the strips next to both sides move apart is taken off.
    """
    means = []
    for strip in (1, 0, -1, -2):
        within = (place[:, 1] >= up + strip * LIP_BAND) & (place[:, 1] < up + (strip + 1) * LIP_BAND)
        if not within.any():
            return 0.0
        means.append(rise[:, within].mean(axis=1))
    above, over, under, below = means
    return float((over - under - (above - over + under - below) / 2).max())


def follow_dent(relief: Relief, contact: float) -> Spot | Missing:
    """The corner of a mouth that does not open: where the dent between the lips ends."""
    reach, follow = round(DENT_REACH / relief.pixel), max(1, round(FOLLOW / relief.pixel))
    row, rows, depths = relief.row(contact), [], []
    for column in range(relief.column(0.0), relief.column(WIDEST)):
        near = relief.height[row - follow : row + follow + 1, column]
        row = row - follow + int(near.argmin())
        if row < reach or row + reach >= len(relief.height):
            break
        depth = (relief.height[row + reach, column] + relief.height[row - reach, column]) / 2
        rows.append(row)
        depths.append(depth - relief.height[row, column])
    usual = float(np.median(depths[: round(DENT_MIDDLE / relief.pixel)])) if depths else 0.0
    if usual <= 0.0:
        return Missing("no dent between the lips")
    ended = np.flatnonzero(np.array(depths) < DENT_END * usual)
    ended = ended[ended >= round(0.15 / relief.pixel)]
    if not len(ended):
        return Missing("the dent between the lips goes on to the side of the face")
    end = int(ended[0])
    column = relief.column(0.0) + end
    height = float(relief.height[rows[end], column])
    return Spot(relief.left(column), relief.up(rows[end]), height, trust(usual))
