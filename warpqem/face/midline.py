"""The feature points on the midline of a face, by walks along its profile."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpqem.face.relief import Relief, make_relief
from warpqem.face.spots import Missing, Spot, trust
from warpqem.face.walks import Stop, from_chord, walk_tilted, walk_to_extremum

__all__ = ["ProfileSpots", "find_profile", "find_throat"]

# The profile is the mean over this much to both sides, in noses.
STRIP = 0.02
# The tip of the nose is this close to where the coarse relief has it.
TIP_SEARCH = 0.2
# An extremum of lips and chin stands out by this much, in noses.
PROMINENCE = 0.004
# Forehead beyond the root of the nose that its chord spans.
FOREHEAD = 0.35
# The contact of the lips found by its motion is the profile's dent within this distance, if there is one.
CONTACT_SEARCH = 0.06
# Throats are looked for from this many degrees below, down to so many noses under the chin.
THROAT_VIEW, THROAT_REACH = 45.0, 1.6

Found = dict[str, Spot | Missing]


@dataclass(frozen=True)
class ProfileSpots:
    """What a profile tells.

    Attributes:
        spots: by name.
    """

    spots: Found

    def up(self, name: str) -> float | None:
        """The height of a point that was found."""
        spot = self.spots.get(name)
        return spot.up if isinstance(spot, Spot) else None


def find_profile(relief: Relief, contact: tuple[float, float] | None) -> ProfileSpots:
    """Walk along the profile from the tip of the nose.

    Args:
        relief: in noses, the tip of the nose near its origin.
        contact: height at which the lips part in motion, and how sure that is; None where they never do.
    """
    profile = relief.along_column(0.0, STRIP)
    spots: Found = {}

    def put(name: str, stop: Stop | None, confidence: float | None = None) -> None:
        if stop is None:
            spots[name] = Missing("the profile of the face has no such extremum")
            return
        sure = trust(stop.prominence) if confidence is None else confidence
        spots[name] = Spot(0.0, relief.up(stop.at), float(profile[stop.at]), sure)

    near = slice(relief.row(-TIP_SEARCH), relief.row(TIP_SEARCH) + 1)
    if not np.isfinite(profile[near]).any():
        return ProfileSpots({"nose_tip": Missing("the surface has a hole at the nose")})
    tip = near.start + int(np.nanargmax(profile[near]))
    holes = np.flatnonzero(~np.isfinite(profile))
    low = int(holes[holes < tip].max(initial=-1)) + 1
    high = int(holes[holes > tip].min(initial=len(profile))) - 1
    put("nose_tip", Stop(tip, 1.0))
    foot = walk_tilted(profile, tip, low, -1.0, PROMINENCE, relief.pixel)
    top = walk_tilted(profile, tip, high, -1.0, PROMINENCE, relief.pixel)
    if top is not None:
        top = from_chord(profile, tip, min(high, top.at + round(FOREHEAD / relief.pixel)), -1.0, relief.pixel)
    put("nose_top", top)
    lips = _lips(relief, profile, foot, low, contact)
    bottom = None
    if lips["upper_lip"] is not None:
        bottom = from_chord(profile, tip, lips["upper_lip"].at, -1.0, relief.pixel)
    put("nose_bottom", bottom if bottom is not None else foot)
    for name, stop in lips.items():
        put(name, stop, contact[1] if name == "lip_contact" and contact is not None and stop is not None else None)
    for name, stop in _chin(relief, profile, lips, low).items():
        put(name, stop)
    return ProfileSpots(spots)


def _lips(
    relief: Relief, profile: np.ndarray, foot: Stop | None, low: int, contact: tuple[float, float] | None
) -> dict[str, Stop | None]:
    """Upper lip, contact and lower lip: bump, dent, bump below the foot of the nose."""
    none: dict[str, Stop | None] = {"upper_lip": None, "lip_contact": None, "lower_lip": None}
    if foot is None:
        return none
    if contact is None:
        upper = walk_to_extremum(profile, foot.at, low, 1.0, PROMINENCE)
        meet = None if upper is None else walk_to_extremum(profile, upper.at, low, -1.0, PROMINENCE)
    else:
        row, reach = relief.row(contact[0]), round(CONTACT_SEARCH / relief.pixel)
        near = profile[row - reach : row + reach + 1]
        # A dent at the edge of the search is a slope to somewhere else.
        dent = int(np.nanargmin(near)) if np.isfinite(near).any() else reach
        row = row - reach + dent if 0 < dent < len(near) - 1 else row
        meet = Stop(row, contact[1])
        upper = walk_to_extremum(profile, row, foot.at, 1.0, PROMINENCE)
        if upper is None:
            upper = from_chord(profile, row, foot.at, 1.0, relief.pixel)
    if meet is None:
        return {**none, "upper_lip": upper}
    return {
        "upper_lip": upper,
        "lip_contact": meet,
        "lower_lip": walk_to_extremum(profile, meet.at, low, 1.0, PROMINENCE),
    }


def _chin(relief: Relief, profile: np.ndarray, lips: dict[str, Stop | None], low: int) -> dict[str, Stop | None]:
    """The crease under the lower lip, and the chin."""
    start = lips["lower_lip"]
    if start is None:
        return {"lip_bottom": None, "chin": None}
    crease = walk_tilted(profile, start.at, low, -1.0, PROMINENCE, relief.pixel)
    chin = None if crease is None else walk_tilted(profile, crease.at, low, 1.0, PROMINENCE, relief.pixel)
    return {"lip_bottom": crease, "chin": chin}


def find_throat(points: np.ndarray, faces: np.ndarray, chin: Spot, pixel: float, sigma: float) -> Spot | Missing:
    """The corner between chin and neck: the dent of the profile seen from below (points (V, 3) in noses)."""
    angle = np.radians(THROAT_VIEW)
    turn = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(angle), np.sin(angle)], [0.0, -np.sin(angle), np.cos(angle)]])
    at = turn @ (chin.left, chin.up, chin.forward)
    half = 0.2
    relief = make_relief(points @ turn.T, faces, (-half, at[1] - THROAT_REACH), (half, at[1] + half), pixel)
    relief = relief.smoothed(sigma)
    profile = relief.along_column(0.0, STRIP)
    stop = None
    if np.isfinite(profile[relief.row(at[1])]):
        stop = walk_to_extremum(profile, relief.row(at[1]), 0, -1.0, 5.0 * PROMINENCE)
    if stop is None:
        return Missing("below the chin the surface ends before it turns to a neck")
    place = turn.T @ (0.0, relief.up(stop.at), profile[stop.at])
    return Spot(0.0, float(place[1]), float(place[2]), trust(stop.prominence))
