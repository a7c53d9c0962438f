"""Texture coordinates of the output that fit the input's: seams stay on their lines, and no triangle is turned over.

A seam's coordinates are fitted along it, into their island by what the seam bends, and out of it by a part of that:
further out, one side would show what lies beyond its island. None leaves the tiles, squares between whole numbers, that
the input has there: beyond them another image of a UDIM set shows, or nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from warpqem.attribute_fit.solve import fit_values, misfits
from warpqem.attribute_fit.turned_triangles import areas_at, turned_back
from warpqem.attribute_fit.values import ValueLayout, fit_smooth_values
from warpqem.mesh.components import lowest_members
from warpqem.mesh.directions import unit_vectors
from warpqem.mesh.edges import edge_key
from warpqem.mesh.grouping import order_by

__all__ = ["fit_texture", "reference_signs"]

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]
Flags = npt.NDArray[np.bool_]

# Along a seam a value goes no further than this part of the way to its neighbour on it, so that they keep their order.
MAX_SLIDE = 0.4
# Into its island it goes no further than its distance from the line between them, out of it no further than this part
# of that. Of a circle's chords the best fit lies a sixth of that further out.
MAX_BEND_OUT = 0.25
# Steps of the fit that says how far they would go: an error of a thousandth is less than what these bounds do.
SLIDE_STEPS = 6
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
        before: (R,) the value before on the seam, -1 where the seam ends or meets a border.
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
    slid = _slide(outline, layout, values, start, signs)
    fitted = tiles.clip(fit_smooth_values(layout, values, slid, ~outline.on_seam))
    better = _where_better(layout, values, start, fitted)
    return turned_back(layout.corner_row, better, signs, tiles.lower, tiles.upper)


def reference_signs(
    layout: ValueLayout, values: Floats, source_face: Ints, is_turned: npt.NDArray[np.bool_]
) -> npt.NDArray[np.int8]:
    """Which way each triangle of the output is to turn, (N',): 0 for either.

    As most of the input does at its samples; where that says nothing, as the face does that it goes on from.

    Args:
        layout: where values stand.
        values: (E, 2) float64, of the input.
        source_face: (N',) int32, the input's face that each face of the output goes on from.
        is_turned: (N,) bool, faces of the input that the output has the other way round.
    """

    def turns(face: npt.NDArray[np.int32] | slice) -> npt.NDArray[np.int8]:
        sign = np.sign(areas_at(values, layout.corner_element[face])).astype(np.int8)
        return np.negative(sign, out=sign, where=is_turned[face])

    partner = layout.partners.face_on_host
    # Of the whole input only where there are as many samples.
    is_few = partner.size < len(layout.corner_element)
    found = turns(partner.ravel()).reshape(partner.shape) if is_few else turns(np.s_[:])[partner]
    most = np.sign(np.where(partner >= 0, found, 0).sum(axis=1)).astype(np.int8)
    unknown = np.flatnonzero(most == 0)
    most[unknown] = turns(source_face[unknown])
    return most


def _find_tiles(layout: ValueLayout, values: Floats, start: Floats) -> _Tiles:
    """The tiles of the start and of the input's faces at the samples of the faces that have a value."""
    lower, upper = np.floor(start + ON_BORDER), np.ceil(start - ON_BORDER)
    if all(_is_within_one_tile(values[:, k], start[:, k]) for k in (0, 1)):
        return _Tiles(lower, upper)
    partner, row = layout.partners.face_on_host, layout.corner_row.ravel()
    first, second, third = (values[layout.corner_element[:, k]] for k in range(3))
    lowest = np.floor(np.minimum(np.minimum(first, second), third))
    highest = np.ceil(np.maximum(np.maximum(first, second), third))
    for k in (0, 1):
        # What is last stands for no partner, which is -1.
        low, high = np.append(lowest[:, k], np.inf)[partner], np.append(highest[:, k], -np.inf)[partner]
        # `at` is fast on whole arrays of one axis.
        column = lower[:, k].copy(), upper[:, k].copy()
        np.minimum.at(column[0], row, np.repeat(low.min(axis=1), 3))
        np.maximum.at(column[1], row, np.repeat(high.max(axis=1), 3))
        lower[:, k], upper[:, k] = column
    return _Tiles(lower, upper)


def _is_within_one_tile(values: Floats, start: Floats) -> bool:
    """Whether values (E,) and (R,) of one channel all are between the same two whole numbers, and on none of them."""
    least, most = (float(pick([pick(values), pick(start)])) for pick in (np.min, np.max))
    return bool(np.floor(least - ON_BORDER) == np.ceil(most + ON_BORDER) - 1)


def _find_outline(faces: Ints, corner_row: Ints, row_count: int) -> _Outline:
    tail, head = corner_row.ravel().astype(np.int64), corner_row.take((1, 2, 0), axis=1).ravel().astype(np.int64)
    vertex_count = int(faces.max()) + 1
    key = edge_key(faces.ravel(), faces.take((1, 2, 0), axis=1).ravel(), vertex_count)
    order = order_by(key, vertex_count**2)
    same = key[order[1:]] == key[order[:-1]]
    first, second = order[:-1][same], order[1:][same]
    if (same[1:] & same[:-1]).any():
        is_open = ~np.isin(tail * row_count + head, head * row_count + tail)
    else:
        # With two faces at each edge it is open where these have other values.
        opposite = (tail[first] == head[second]) & (head[first] == tail[second])
        is_open = tail != head
        is_open[first[opposite]] = is_open[second[opposite]] = False
    has_beyond = np.zeros(len(key), dtype=bool)
    has_beyond[first] = has_beyond[second] = True
    seam = is_open & has_beyond
    leaving, arriving = (np.bincount(end[is_open], minlength=row_count) for end in (tail, head))
    before, after = np.full(row_count, -1), np.full(row_count, -1)
    before[head[seam]], after[tail[seam]] = tail[seam], head[seam]
    through = (leaving == 1) & (arriving == 1) & (before >= 0) & (after >= 0)
    on_seam = np.zeros(row_count, dtype=bool)
    on_seam[tail[seam]] = on_seam[head[seam]] = True
    return _Outline(on_seam, np.where(through, before, -1), np.where(through, after, -1))


def _slide(
    outline: _Outline, layout: ValueLayout, values: Floats, start: Floats, signs: npt.NDArray[np.int8]
) -> Floats:
    """The start with values of seams moved along them as far as a fit without seams would move them.

    Across a seam they go by what it bends at most, as straight edges cut its bends off; a straight one stays so.
    """
    row = np.flatnonzero(outline.after >= 0)
    if not len(row):
        return start
    misfit = misfits(layout.partners, layout.corner_element, values, layout.corner_row, start)
    change = fit_values(layout.partners, misfit, layout.corner_row, np.ones(len(start), dtype=bool), SLIDE_STEPS)[row]
    back, forth = start[outline.before[row]] - start[row], start[outline.after[row]] - start[row]
    reach = [MAX_SLIDE * np.linalg.norm(to, axis=1) for to in (back, forth)]
    along = unit_vectors(forth - back)
    # Seams run as the faces beside them turn, so that the island is on the left of those that turn counter-clockwise.
    side = np.sign(np.bincount(layout.corner_row.ravel(), np.repeat(signs, 3), len(start)))[row]
    inwards = side[:, None] * np.stack([-along[:, 1], along[:, 0]], axis=1)
    bend = np.abs((back * inwards).sum(axis=1))
    way = np.clip((change * along).sum(axis=1), -reach[0], reach[1])
    into = np.clip((change * inwards).sum(axis=1), -MAX_BEND_OUT * bend, bend)
    slid = start.copy()
    slid[row] += way[:, None] * along + into[:, None] * inwards
    return slid


def _where_better(layout: ValueLayout, values: Floats, start: Floats, fitted: Floats) -> Floats:
    """The fitted values of charts that they bring nearer to the input at the samples; those of others stay as they are.

    Both the mean error and the mean square count: a few samples on an island that went decide the latter alone.
    """
    row, partner = layout.corner_row, layout.partners.face_on_host
    chart = lowest_members(len(start), np.concatenate([row[:, :2], row[:, 1:]]))
    area = np.where(partner >= 0, layout.partners.area[:, None], 0.0)
    samples, owner = layout.partners.samples.T, chart[row[:, 0]]
    element, weight = layout.corner_element[partner], layout.partners.weight_on_host
    squared = [np.zeros(partner.shape) for _ in range(2)]
    # One channel and one corner after the other takes a third of the time of arrays of all of them.
    for k in range(values.shape[1]):
        channel = values[:, k]
        wanted = np.add.reduce([weight[..., j] * channel[element[..., j]] for j in range(3)])
        for total, found in zip(squared, (start, fitted), strict=True):
            total += (wanted - found[row, k] @ samples) ** 2
    better = np.ones(len(start), dtype=bool)
    for was, now in (squared, np.sqrt(squared)):
        before, after = (np.bincount(owner, (area * error).sum(axis=1), len(start)) for error in (was, now))
        better &= after <= before
    return np.where(better[chart][:, None], fitted, start)
