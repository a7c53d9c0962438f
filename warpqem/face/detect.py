"""Find the places of all feature points of a face whose orientation is known."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from warpqem.face.contact_line import ContactLine, find_contact_line
from warpqem.face.feature_names import FEATURE_NAMES
from warpqem.face.lids import closing_lid
from warpqem.face.midline import ProfileSpots, find_profile, find_throat
from warpqem.face.mouth import LipMotion, find_parting, follow_dent
from warpqem.face.nose import FaceUnits, find_units
from warpqem.face.relief import Relief, make_relief
from warpqem.face.sides import CornerFinder, LidFinder, find_side
from warpqem.face.skin_regions import FaceSkin, without_head_motion
from warpqem.face.spots import Missing, Spot

__all__ = ["FoundFace", "FoundMidline", "find_midline", "find_spots"]

Found = dict[str, Spot | Missing]

# The face around the tip of the nose, in noses: to the sides, below and above.
HALF_WIDTH, BELOW, ABOVE = 1.75, 2.2, 2.2
# Half the width that a profile needs.
STRIP_WIDTH = 0.125
# For comparing directions: samples across a surface to find the nose, and distance between samples of the profile.
STRIP_SAMPLES, STRIP_PIXEL = 128, 0.025
# Distance between samples, and smoothing: 0.02 noses are about a millimetre, less than any feature.
PIXEL, SIGMA = 0.0125, 0.02
# Coarse meshes are smoothed by this part of the median edge of the face, so that facets are no features. Lips and eyes
# have finer edges than the skull.
EDGE_SIGMA = 0.4
FACE_REACH = 1.2
# A head's sides are looked for between these heights: from the foot of the nose, and over its root.
SIDE_BELOW, SIDE_ABOVE = 0.3, 1.2
# An extremum this close to an open border is one of the cut, not of the head.
BORDER = 0.12
# A pair whose halves are farther apart than this, when one is mirrored, is looked for on the mean of both sides.
PAIR_AGREES = 0.2
# Points of the head's outline need no prominence: there is one highest point.
OUTLINE = 0.9


@dataclass(frozen=True)
class FoundFace:
    """Places in noses, and what they are measured in."""

    units: FaceUnits
    spots: Found


@dataclass(frozen=True)
class FoundMidline:
    """The profile of a face, and what it is measured in."""

    units: FaceUnits
    relief: Relief
    sigma: float
    profile: ProfileSpots

    @property
    def spots(self) -> Found:
        """The points on the profile."""
        return self.profile.spots


def find_midline(points: np.ndarray, skin: FaceSkin, axes: np.ndarray, strip: bool = False) -> FoundMidline | None:
    """The nose and the profile of a face with points (V, 3); None where there is no nose.

    With ``strip`` the relief is that of the profile alone, and coarser: enough to compare directions.
    """
    units = find_units(points, skin.seen, axes, STRIP_SAMPLES) if strip else find_units(points, skin.seen, axes)
    if units is None:
        return None
    local = units.local(points)
    sigma = max(SIGMA, EDGE_SIGMA * _edge_length(local, skin.faces))
    half = STRIP_WIDTH if strip else HALF_WIDTH
    low, high = (-half, -BELOW), (half, ABOVE)
    relief = make_relief(local, skin.seen, low, high, STRIP_PIXEL if strip else PIXEL).smoothed(sigma)
    return FoundMidline(units, relief, sigma, find_profile(relief, None))


def find_spots(points: np.ndarray, skin: FaceSkin, axes: np.ndarray) -> FoundFace | None:
    """Find the feature points in the first frame.

    Args:
        points: (F, V, 3) float64; later frames tell where lids close, and where lips part that are not cut apart.
        skin: of the mesh.
        axes: (3, 3), unit vectors to the person's left, up and forward.

    Returns:
        None where there is no nose.
    """
    middle = find_midline(points[0], skin, axes)
    if middle is None:
        return None
    units, relief, first = middle.units, middle.relief, middle.profile
    local = units.local(points[0])
    bottom = first.up("nose_bottom")
    lips: ContactLine | LipMotion | None = None
    lids: tuple[LidFinder | None, LidFinder | None] = (None, None)
    if bottom is not None and len(points) > 1:
        still = without_head_motion(points, skin.vertices)[:, skin.vertices]
        rise = units.local_vectors(still - still[:1])[..., 1]
        place = local[skin.vertices]
        lips = find_parting(place, rise, relief, bottom)
        lids = (partial(closing_lid, place, rise), partial(closing_lid, place * (-1.0, 1.0, 1.0), rise))
    if bottom is not None:
        lips = find_contact_line(local, skin.faces, relief, bottom) or lips
    profile = first if lips is None else find_profile(relief, (lips.up, lips.confidence))
    spots: Found = dict(profile.spots)
    spots.update(_outline(local, skin, profile.up("nose_bottom"), profile.up("nose_top")))
    chin = spots.get("chin")
    if isinstance(chin, Spot):
        spots["throat"] = find_throat(local, skin.faces, chin, PIXEL, middle.sigma)
    left = find_side(relief, profile, _corner(lips), lids[0])
    right = find_side(relief.mirrored(), profile, _corner(None if lips is None else lips.mirrored()), lids[1])
    even = find_side(relief.evened(), profile, _corner(lips), lids[0])
    for name in left:
        spots[f"{name}_left"], spots[f"{name}_right"] = _pair(left[name], right[name], even[name])
    unreached = Missing("what it is found from is missing")
    return FoundFace(units, {name: spots.get(name, unreached) for name in FEATURE_NAMES})


def _edge_length(local: np.ndarray, faces: np.ndarray) -> float:
    """Median length of the edges around the nose, in noses."""
    around = faces[np.linalg.norm(local[faces[:, 0]], axis=1) < FACE_REACH]
    sides = local[around] - local[np.roll(around, 1, axis=1)]
    return float(np.median(np.linalg.norm(sides, axis=2))) if len(around) else 0.0


def _corner(lips: ContactLine | LipMotion | None) -> CornerFinder:
    return follow_dent if lips is None else lips.corner


def _outline(local: np.ndarray, skin: FaceSkin, bottom: float | None, top: float | None) -> Found:
    """Top and sides of the head."""
    place = local[skin.vertices]
    border = local[skin.border]

    def outermost(axis: int, sign: float, allowed: np.ndarray) -> Spot | Missing:
        if not allowed.any():
            return Missing("the surface does not reach there")
        at = place[allowed][int((sign * place[allowed][:, axis]).argmax())]
        if len(border) and np.linalg.norm(border - at, axis=1).min() < BORDER:
            return Missing("the surface is cut off there")
        return Spot(float(at[0]), float(at[1]), float(at[2]), OUTLINE)

    spots: Found = {"head_top": outermost(1, 1.0, np.ones(len(place), dtype=bool))}
    if bottom is not None and top is not None:
        level = (place[:, 1] > bottom - SIDE_BELOW) & (place[:, 1] < top + SIDE_ABOVE)
        spots["head_side_left"] = outermost(0, 1.0, level)
        spots["head_side_right"] = outermost(0, -1.0, level)
        both = [spots[f"head_side_{side}"] for side in ("left", "right")]
        if any(isinstance(spot, Missing) for spot in both):
            # One side alone is more likely wrong than right.
            spots.update({f"head_side_{side}": Missing("the surface is cut off there") for side in ("left", "right")})
    return spots


def _pair(left: Spot | Missing, right: Spot | Missing, even: Spot | Missing) -> tuple[Spot | Missing, Spot | Missing]:
    """Both halves of a pair, the right one mirrored back to its side."""
    if isinstance(left, Spot) and isinstance(right, Spot):
        apart = float(np.hypot(left.left - right.left, left.up - right.up))
        if apart <= PAIR_AGREES:
            agreement = 1.0 - 0.5 * apart / PAIR_AGREES
            left, right = (replace(spot, confidence=spot.confidence * agreement) for spot in (left, right))
            return left, replace(right, left=-right.left)
    if isinstance(even, Missing):
        return (even, even)
    # What both sides show together, at half the confidence as each shows something else.
    even = replace(even, confidence=0.5 * even.confidence)
    return even, replace(even, left=-even.left)
