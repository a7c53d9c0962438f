"""Texture coordinates of the output that fit the input's: seams stay on their lines, and no triangle is turned over.

A seam's coordinates are fitted along it, and across it by a part of what it bends: further, one side would show what
lies beyond its island. None leaves the tiles, squares between whole numbers, that the input has there: beyond them
another image of a UDIM set shows, or nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from warpqem.attribute_fit.solve import fit_values, misfits
from warpqem.attribute_fit.values import ValueLayout, fit_smooth_values
from warpqem.mesh.edges import edge_key

__all__ = ["face_signs", "fit_texture", "reference_signs"]

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]
Flags = npt.NDArray[np.bool_]

# Along a seam a value goes no further than this part of the way between its neighbours on it, so that they keep their
# order.
MAX_SLIDE = 0.2
# Across it no further than this part of its distance from the line between them. Of a circle's chords the best fit lies
# a sixth of that further out.
MAX_BEND = 0.25
# Rounds that halve changes, and that draw values to their neighbours, until no triangle is turned over.
HALVINGS = 6
UNTANGLE_ROUNDS = 20
# Triangles that are looked at one by one at last, and how far beyond its edge a corner goes, in parts of its height.
MAX_FOLDS = 1000
BEYOND = 0.1
# Values so near to the border of a tile are on it: means of values there are in single precision.
ON_BORDER = 1e-6


@dataclass(frozen=True)
class _Tiles:
    """The tiles that R values may be in.

    Attributes:
        lower: (R, 2) whole numbers.
        upper: likewise.
    """

    lower: Floats
    upper: Floats

    def clip(self, values: Floats) -> Floats:
        """Values (R, 2), those beyond their tiles on the border."""
        return np.asarray(np.clip(values, self.lower, self.upper))


@dataclass(frozen=True)
class _Outline:
    """The seams of R values.

    Attributes:
        on_seam: (R,) bool, values with a seam on one side.
        before: (R,) the value before on the seam, -1 where the seam ends, forks or meets a border.
        after: (R,) the one after.
    """

    on_seam: Flags
    before: npt.NDArray[np.int64]
    after: npt.NDArray[np.int64]


def fit_texture(faces: Ints, layout: ValueLayout, values: Floats, start: Floats, signs: npt.NDArray[np.int8]) -> Floats:
    """Texture coordinates (R, 2) for the output that fit those of the input best.

    Args:
        faces: (N', 3) int32, the output.
        layout: where they stand.
        values: (E, 2) float64, of the input.
        start: (R, 2) float64, so far.
        signs: (N',) which way each triangle of the output is to turn, see :func:`reference_signs`.
    """
    outline, tiles = _find_outline(faces, layout.corner_row, len(start)), _find_tiles(layout, values, start)
    slid = _slide(outline, layout, values, start)
    fitted = tiles.clip(fit_smooth_values(layout, values, slid, ~outline.on_seam))
    return tiles.clip(_turned_back(layout.corner_row, fitted, start, signs, ~outline.on_seam, tiles))


def face_signs(corners: Floats) -> npt.NDArray[np.int8]:
    """Which way triangles (N, 3, 2) turn: 1 counter-clockwise, -1 clockwise, 0 without area."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.sign(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]).astype(np.int8)


def reference_signs(layout: ValueLayout, values: Floats) -> npt.NDArray[np.int8]:
    """Which way each triangle of the output is to turn: as most of the input does at its samples; 0 for either."""
    sign = face_signs(values[layout.corner_element])
    partner = layout.partners.face.numpy()
    return np.sign(np.where(partner >= 0, sign[partner], 0).sum(axis=1)).astype(np.int8)


def _find_tiles(layout: ValueLayout, values: Floats, start: Floats) -> _Tiles:
    """The tiles of the start and of the input's faces at the samples of the faces that have a value."""
    lower, upper = np.floor(start + ON_BORDER), np.ceil(start - ON_BORDER)
    partner = layout.partners.face.numpy()
    has_partner, corner = (partner >= 0)[..., None], values[layout.corner_element]
    row = layout.corner_row.ravel()
    lowest = np.where(has_partner, np.floor(corner.min(axis=1))[partner], np.inf).min(axis=1)
    np.minimum.at(lower, row, np.repeat(lowest, 3, axis=0))
    highest = np.where(has_partner, np.ceil(corner.max(axis=1))[partner], -np.inf).max(axis=1)
    np.maximum.at(upper, row, np.repeat(highest, 3, axis=0))
    return _Tiles(lower, upper)


def _find_outline(faces: Ints, corner_row: Ints, row_count: int) -> _Outline:
    tail, head = corner_row.ravel().astype(np.int64), np.roll(corner_row, -1, axis=1).ravel().astype(np.int64)
    is_open = ~np.isin(tail * row_count + head, head * row_count + tail)
    vertex = faces.ravel().astype(np.int64)
    key = edge_key(vertex, np.roll(faces, -1, axis=1).ravel(), int(vertex.max()) + 1)
    _, edge, count = np.unique(key, return_inverse=True, return_counts=True)
    seam = is_open & (count[edge.ravel()] > 1)
    leaving, arriving = (np.bincount(end[is_open], minlength=row_count) for end in (tail, head))
    before, after = np.full(row_count, -1), np.full(row_count, -1)
    before[head[seam]], after[tail[seam]] = tail[seam], head[seam]
    # A vertex in the middle of a seam has a value on either side of it.
    owner = np.zeros(row_count, dtype=np.int64)
    owner[tail] = vertex
    sides = np.bincount(owner[np.unique(tail)], minlength=int(vertex.max()) + 1)[owner]
    through = (leaving == 1) & (arriving == 1) & (before >= 0) & (after >= 0) & (sides <= 2)
    on_seam = np.zeros(row_count, dtype=bool)
    on_seam[tail[seam]] = on_seam[head[seam]] = True
    return _Outline(on_seam, np.where(through, before, -1), np.where(through, after, -1))


def _slide(outline: _Outline, layout: ValueLayout, values: Floats, start: Floats) -> Floats:
    """The start with values of seams moved along them as far as a fit without seams would move them.

    Across a seam they go by a part of what it bends, as straight edges cut its bends off; a straight one stays so.
    """
    row = np.flatnonzero(outline.after >= 0)
    if not len(row):
        return start
    misfit = misfits(layout.partners, layout.corner_element, values, layout.corner_row, start)
    change = fit_values(layout.partners, misfit, layout.corner_row, np.ones(len(start), dtype=bool))[row]
    along = start[outline.after[row]] - start[outline.before[row]]
    squared = (along**2).sum(axis=1)
    share = np.divide((change * along).sum(axis=1), squared, out=np.zeros(len(row)), where=squared > 0)
    slid = start.copy()
    slid[row] += np.clip(share, -MAX_SLIDE, MAX_SLIDE)[:, None] * along
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
    normal = np.divide(normal, np.sqrt(squared)[:, None], out=np.zeros_like(normal), where=squared[:, None] > 0)
    bend = np.abs(((start[row] - start[outline.before[row]]) * normal).sum(axis=1))
    slid[row] += np.clip((change * normal).sum(axis=1), -MAX_BEND * bend, MAX_BEND * bend)[:, None] * normal
    return slid


def _turned_back(
    corner_row: Ints, fitted: Floats, start: Floats, signs: npt.NDArray[np.int8], free: Flags, tiles: _Tiles
) -> Floats:
    """Fitted values with less change, or none, where a triangle would be turned over by it."""

    def turned(values: Floats) -> Flags:
        return np.asarray(face_signs(values[corner_row]) * signs < 0, dtype=bool)

    was = turned(start)
    share = np.ones(len(start))
    values = fitted
    for last in [*[False] * HALVINGS, True]:
        bad = turned(values) & ~was
        if not bad.any():
            break
        rows = np.unique(corner_row[bad])
        share[rows] = 0.0 if last else share[rows] / 2
        values = start + share[:, None] * (fitted - start)
    while (bad := turned(values) & ~was).any() and share.any():
        # A neighbour of a triangle that is as before may be turned over by the other one's values.
        share[np.unique(corner_row[bad])] = 0.0
        values = start + share[:, None] * (fitted - start)
    # First by the least change, which is most often enough; values of seams only where nothing else helps.
    values = _folded_back(corner_row, values, signs, free, tiles)
    values = _untangled(corner_row, values, signs, free, tiles)
    return _folded_back(corner_row, values, signs, np.ones_like(free), tiles)


def _untangled(corner_row: Ints, values: Floats, signs: npt.NDArray[np.int8], free: Flags, tiles: _Tiles) -> Floats:
    """The same with fewer triangles turned over: their values are drawn to the middle of their neighbours'."""
    tail, head = corner_row.ravel(), np.roll(corner_row, -1, axis=1).ravel()
    ends, others = np.concatenate([tail, head]), np.concatenate([head, tail])

    def count(trial: Floats) -> int:
        return int((face_signs(trial[corner_row]) * signs < 0).sum())

    left = count(values)
    for _ in range(UNTANGLE_ROUNDS):
        if not left:
            break
        bad = face_signs(values[corner_row]) * signs < 0
        moved = np.zeros(len(values), dtype=bool)
        moved[corner_row[bad]] = True
        moved &= free
        near = moved[ends]
        degree = np.bincount(ends[near], minlength=len(values))
        middle = np.stack([np.bincount(ends[near], values[others[near], k], len(values)) for k in (0, 1)], axis=1)
        trial = np.where(moved[:, None], tiles.clip(middle / np.maximum(degree, 1)[:, None]), values)
        after = count(trial)
        if after >= left:
            break
        values, left = trial, after
    return values


def _folded_back(corner_row: Ints, values: Floats, signs: npt.NDArray[np.int8], free: Flags, tiles: _Tiles) -> Floats:
    """The same where triangles that are turned over are folded back at one of their edges, one by one.

    Most are slivers: a free corner goes to the other side of its edge, where that turns no other one over.
    """
    values = values.copy()
    bad = np.flatnonzero(face_signs(values[corner_row]) * signs < 0)[:MAX_FOLDS]
    faces_at = _faces_at(corner_row, corner_row[bad])
    for face in bad:
        rows = corner_row[face]
        best, chosen, shift = np.inf, -1, np.zeros(2)
        for k in np.flatnonzero(free[rows]):
            apex, first, second = values[rows[k]], values[rows[k - 2]], values[rows[k - 1]]
            along = second - first
            across = np.array([-along[1], along[0]])
            squared = along[0] * along[0] + along[1] * along[1]
            move = -(1 + BEYOND) * ((apex - first) @ across) / squared * across if squared > 0 else along
            # On the border of its tile, where the fold would take it out.
            goal = np.minimum(np.maximum(apex + move, tiles.lower[rows[k]]), tiles.upper[rows[k]])
            move = goal - apex
            length = float(np.linalg.norm(move))
            if not length < best:
                continue
            near = faces_at[rows[k]]
            around, signs_around = corner_row[near], signs[near]
            corners = values[around]
            before = np.count_nonzero(face_signs(corners) * signs_around < 0)
            trial = corners + np.where(around == rows[k], 1.0, 0.0)[:, :, None] * move
            if np.count_nonzero(face_signs(trial) * signs_around < 0) < before:
                best, chosen, shift = length, rows[k], move
        if chosen >= 0:
            values[chosen] += shift
    return values


def _faces_at(corner_row: Ints, rows: Ints) -> dict[int, npt.NDArray[np.int64]]:
    """The triangles (n,) at each of some values, ascending."""
    return {int(row): np.flatnonzero((corner_row == row).any(axis=1)) for row in np.unique(rows)}
