"""The feature points on one side of a face: nose wing, eye, brow, cheek and lips, by walks from the midline outwards.

Everything is in noses, on the side where left is positive; the other side is walked on the mirrored relief.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from warpqem.face.midline import ProfileSpots
from warpqem.face.relief import Relief
from warpqem.face.spots import Missing, Spot, trust
from warpqem.face.walks import Stop, from_chord, walk_to_extremum

__all__ = ["CornerFinder", "LidFinder", "find_side"]

Found = dict[str, Spot | Missing]
# The corner of the mouth from the relief and the height of the contact.
CornerFinder = Callable[[Relief, float], Spot | Missing]
# How far out a closing lid is, from where the eye is expected and how far around to look.
LidFinder = Callable[[tuple[float, float], float], float | None]

# Rows and columns are the mean over this much to both sides.
STRIP = 0.03
# The wing of the nose is widest this far above the corner between nose and lip. Its rim, seen from half the side, lies
# within the first two distances; the groove beside it ends before the last.
WING_UP, WING_FROM, WING_RIM, WING_TO = 0.2, 0.15, 0.36, 0.55
# Where eyes are: from the midline, and below the root of the nose; a bump as wide as this is looked for no farther
# away than that.
EYE_LEFT, EYE_DOWN, EYE_SIGMA, EYE_SEARCH = 0.62, 0.04, 0.06, 0.15
# The chord over the inner corner begins on the ridge of the nose. The eye is foremost this close to where its bump is.
RIDGE, EYE_TOP = 0.08, 0.15
# What is told from the other corner is trusted so much less.
MIRRORED = 0.7
# The chord over the brow begins in the hollow of the eye, at most the first height above its middle, and ends at the
# last; on a surface that is cut off it may end at the second.
HOLLOW, BROW_LEAST, BROW_TO = 0.25, 0.4, 0.55
# Brows are found this much towards the middle of the eye from its corners.
BROW_IN = 0.06
# Cheek bones: out of the nose, above its foot, below the eye; seen from that many degrees to the side.
CHEEK_FROM, CHEEK_TO, CHEEK_UP, CHEEK_UNDER_EYE, CHEEK_VIEW = 0.45, 1.4, -0.05, 0.3, 45.0
# An extremum of the lips stands out by this much.
LIP_PROMINENCE = 0.004


def find_side(relief: Relief, profile: ProfileSpots, corner: CornerFinder, lid: LidFinder | None = None) -> Found:
    """All points of the side where left is positive; a lid that closes tells how far out the eye is."""
    spots: Found = {}
    bottom, top = profile.up("nose_bottom"), profile.up("nose_top")
    if bottom is None or top is None:
        return {}
    spots["nose_side"] = _nose_side(relief, bottom)
    expected = (EYE_LEFT, top - EYE_DOWN)
    closing = None if lid is None else lid(expected, EYE_SEARCH)
    eye = _eye_middle(relief, expected if closing is None else (closing, expected[1]))
    spots.update(_eye(relief, eye))
    spots["cheek"] = _cheek(relief, bottom, eye[1])
    contact = profile.up("lip_contact")
    spots["upper_lip"] = spots["lower_lip"] = Missing("no corner of the mouth to go half way to")
    spots["mouth_corner"] = Missing("no contact of the lips") if contact is None else corner(relief, contact)
    if contact is not None and isinstance(spots["mouth_corner"], Spot):
        spots.update(_lips(relief, spots["mouth_corner"], contact, profile))
    return spots


def _on(relief: Relief, left: float, up: float, confidence: float) -> Spot:
    return Spot(left, up, float(relief.height[relief.row(up), relief.column(left)]), confidence)


def _nose_side(relief: Relief, bottom: float) -> Spot | Missing:
    up = bottom + WING_UP
    row = relief.along_row(up, STRIP)
    first = relief.column(WING_FROM)
    half_side = row[first : relief.column(WING_RIM) + 1]
    if not np.isfinite(half_side).all():
        return Missing("the surface has a hole beside the nose")
    rim = first + int((half_side + np.arange(len(half_side)) * relief.pixel).argmax())
    stop = from_chord(row, rim, relief.column(WING_TO), -1.0, relief.pixel)
    if stop is None:
        return Missing("no groove beside the nose")
    return _on(relief, relief.left(stop.at), up, trust(stop.prominence))


def _eye_middle(relief: Relief, expected: tuple[float, float]) -> tuple[float, float]:
    """Left and up of the middle of the eye: the bump that stands out most, near where it is expected."""
    # What there is of the bump is found by the difference of two smoothed reliefs.
    bump = relief.smoothed(EYE_SIGMA).height - relief.smoothed(3.0 * EYE_SIGMA).height
    rows = slice(relief.row(expected[1] - EYE_SEARCH), relief.row(expected[1] + EYE_SEARCH) + 1)
    columns = slice(relief.column(expected[0] - EYE_SEARCH), relief.column(expected[0] + EYE_SEARCH) + 1)
    window = bump[rows, columns]
    ups = (relief.origin[1] + np.arange(rows.start, rows.stop) * relief.pixel - expected[1]) / EYE_SEARCH
    lefts = (relief.origin[0] + np.arange(columns.start, columns.stop) * relief.pixel - expected[0]) / EYE_SEARCH
    # The farther from where eyes are, the less a bump counts, so that brows and cheek bones are none.
    near = np.exp(-(ups[:, None] ** 2 + lefts[None, :] ** 2))
    at = np.unravel_index(int(((window - window.min()) * near).argmax()), window.shape)
    return relief.left(columns.start + int(at[1])), relief.up(rows.start + int(at[0]))


def _eye(relief: Relief, eye: tuple[float, float]) -> Found:
    up = eye[1]
    row = relief.along_row(up, STRIP)
    first = relief.column(eye[0] - EYE_TOP)
    window = row[first : relief.column(eye[0] + EYE_TOP) + 1]
    if not np.isfinite(window).all():
        names = ("eye_inner", "eye_outer", "eye_socket", "brow_inner", "brow_outer")
        return {name: Missing("the surface has a hole at the eye") for name in names}
    left = relief.left(first + int(window.argmax()))
    inner = from_chord(row, relief.column(RIDGE), relief.column(left), -1.0, relief.pixel)
    # The face turns away to the side, so the outer corner is no hollow: it is as far out of the foremost point of the
    # eye as the inner one is inside.
    outer = None
    if inner is not None:
        out = 2 * relief.column(left) - inner.at
        outer = Stop(out, MIRRORED * inner.prominence) if out < len(row) and np.isfinite(row[out]) else None
    spots: Found = {}
    for name, brow, stop, shift in (
        ("eye_inner", "brow_inner", inner, BROW_IN),
        ("eye_outer", "brow_outer", outer, -BROW_IN),
    ):
        if stop is None:
            spots[name] = Missing("no hollow beside the eye")
            spots[brow] = Missing(f"no {name} to look above")
            continue
        at = relief.left(stop.at)
        spots[name] = _on(relief, at, up, trust(stop.prominence))
        spots[brow] = _brow(relief, at + shift, up)
    spots["eye_socket"] = _socket(relief, left, up)
    return spots


def _brow(relief: Relief, left: float, up: float) -> Spot | Missing:
    """Above the eye, the point that stands out most between the hollow of the eye and the forehead."""
    column = relief.along_column(left, STRIP)
    first, last = relief.row(up), relief.row(up + BROW_TO)
    seen = np.flatnonzero(np.isfinite(column[first : last + 1]))
    if len(seen) < 2 or relief.up(first + int(seen[-1])) < up + BROW_LEAST:
        return Missing("the surface ends below the brow")
    last = first + int(seen[-1])
    hollow = first + int(np.nanargmin(column[first : min(relief.row(up + HOLLOW), last) + 1]))
    stop = from_chord(column, hollow, last, 1.0, relief.pixel)
    if stop is None:
        return Missing("nothing stands out above the eye")
    return _on(relief, left, relief.up(stop.at), trust(stop.prominence))


def _socket(relief: Relief, left: float, up: float) -> Spot | Missing:
    brow = _brow(relief, left, up)
    if isinstance(brow, Missing):
        return brow
    stop = from_chord(relief.along_column(left, STRIP), relief.row(up), relief.row(brow.up), -1.0, relief.pixel)
    if stop is None:
        return Missing("no hollow between eye and brow")
    return _on(relief, left, relief.up(stop.at), trust(stop.prominence))


def _cheek(relief: Relief, bottom: float, eye: float) -> Spot | Missing:
    rows = slice(relief.row(bottom + CHEEK_UP), relief.row(eye - CHEEK_UNDER_EYE) + 1)
    columns = slice(relief.column(CHEEK_FROM), relief.column(CHEEK_TO) + 1)
    angle = np.radians(CHEEK_VIEW)
    lefts = relief.origin[0] + np.arange(columns.start, columns.stop) * relief.pixel
    seen = relief.height[rows, columns] * np.cos(angle) + lefts * np.sin(angle)
    seen = np.where(relief.inside[rows, columns], seen, -np.inf)
    if not np.isfinite(seen).any():
        return Missing("the surface does not reach to the cheek")
    row, column = np.unravel_index(int(seen.argmax()), seen.shape)
    edge = [seen[0].max(), seen[-1].max(), seen[:, 0].max(), seen[:, -1].max()]
    rise = float(seen[row, column] - max(value for value in edge if np.isfinite(value)))
    return _on(relief, float(lefts[column]), relief.up(rows.start + int(row)), trust(max(rise, 0.0)))


def _lips(relief: Relief, corner: Spot, contact: float, profile: ProfileSpots) -> Found:
    """The lips half way to the corner."""
    left = corner.left / 2
    spots: Found = {}
    column = relief.along_column(left, STRIP)
    # The line of contact bends on the way to the corner.
    middle = relief.row((contact + corner.up) / 2)
    reach = round(0.06 / relief.pixel)
    near = column[middle - reach : middle + reach + 1]
    if np.isfinite(near).all():
        middle = middle - reach + int(near.argmin())
    for name, end in (("upper_lip", profile.up("nose_bottom")), ("lower_lip", profile.up("lip_bottom"))):
        if end is None:
            spots[name] = Missing("the lip has no end on the midline")
            continue
        stop = walk_to_extremum(column, middle, relief.row(end), 1.0, LIP_PROMINENCE)
        if stop is None:
            stop = from_chord(column, middle, relief.row(end), 1.0, relief.pixel)
        if stop is None:
            spots[name] = Missing("the lip does not stand out")
        else:
            spots[name] = _on(relief, left, relief.up(stop.at), trust(stop.prominence))
    return spots
