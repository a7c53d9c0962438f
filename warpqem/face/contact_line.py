"""The line where lips that are cut apart meet: vertices that lie on each other, one of each lip.

"Vertices of lip contact line are duplicated vertices" (the face paper, after Noh & Neumann 2001): they are taken as
such, whether the face moves or not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpqem.face.mouth import LIPS_FROM, LIPS_TO, OUTSIDE, WIDEST
from warpqem.face.relief import Relief
from warpqem.face.spots import Missing, Spot
from warpqem.mesh.components import lowest_members
from warpqem.mesh.edges import edge_table

__all__ = ["ContactLine", "find_contact_line"]

# Vertices this close to each other, in noses, lie on each other: a twentieth of a millimetre on a head.
TOGETHER = 1e-3
# A line of lips reaches at least this far to both sides of the midline, in noses, and rises and falls by no more than
# that over its length. Mouths are about half a nose wide to each side.
MIN_REACH, MAX_RISE = 0.15, 0.35
# At so many places of the line at least its vertices lie on each other; fewer are an accident of the mesh.
MIN_PLACES = 5
# The line is what the mesh itself says, not an extremum that could be another one.
CONFIDENCE = 0.95


@dataclass(frozen=True)
class ContactLine:
    """Where lips meet.

    Attributes:
        place: (n, 3) float64, the points of the line from the right end to the left one, in noses.
    """

    place: np.ndarray

    @property
    def up(self) -> float:
        """Height of the contact on the midline."""
        return float(np.interp(0.0, self.place[:, 0], self.place[:, 1]))

    @property
    def confidence(self) -> float:
        """0 to 1."""
        return CONFIDENCE

    def mirrored(self) -> ContactLine:
        """Left and right exchanged."""
        return ContactLine((self.place * (-1.0, 1.0, 1.0))[::-1])

    def corner(self, relief: Relief, contact: float) -> Spot | Missing:
        """The left end of the line."""
        left, up, forward = self.place[-1].tolist()
        return Spot(left, up, forward, CONFIDENCE)


def find_contact_line(local: np.ndarray, faces: np.ndarray, relief: Relief, nose_bottom: float) -> ContactLine | None:
    """The line of vertices that lie on each other below the nose; None where there is none.

    Args:
        local: (V, 3) points in noses.
        faces: (N, 3) int, faces of the skin.
        relief: the face in noses.
        nose_bottom: height of the foot of the nose.
    """
    pairs = _pairs(local, faces, relief, nose_bottom)
    if len(pairs) < MIN_PLACES:
        return None
    edges = edge_table(faces).ends
    # One number for all vertices at a place.
    place = lowest_members(len(local), pairs)
    doubled = np.zeros(len(local), dtype=bool)
    doubled[place[pairs[:, 0]]] = True
    joined = place[edges]
    along = joined[doubled[joined].all(axis=1)]
    line = lowest_members(len(local), along)
    for name in np.unique(line[doubled]):
        members = np.flatnonzero(doubled & (line == name))
        if len(members) < MIN_PLACES:
            continue
        at = local[members][np.argsort(local[members, 0], kind="stable")]
        grown = local[_grown_together(members, place, edges, doubled)]
        # Those between the ends lie inside the mouth.
        right, left = grown[grown[:, 0] < at[0, 0]], grown[grown[:, 0] > at[-1, 0]]
        at = np.concatenate([right[right[:, 0].argsort()[:1]], at, left[left[:, 0].argsort()[-1:]]])
        reaches = at[0, 0] < -MIN_REACH and at[-1, 0] > MIN_REACH
        if reaches and np.ptp(at[:, 1]) < MAX_RISE and _divides(members, local, place, faces):
            return ContactLine(at)
    return None


def _pairs(local: np.ndarray, faces: np.ndarray, relief: Relief, nose_bottom: float) -> np.ndarray:
    """(m, 2) int, vertices of the mouth's outside that lie on each other and have no edge in common."""
    from scipy.spatial import cKDTree

    used = np.unique(faces)
    at = local[used]
    within = (at[:, 1] < nose_bottom - LIPS_FROM) & (at[:, 1] > nose_bottom - LIPS_TO) & (np.abs(at[:, 0]) < WIDEST)
    used = used[within]
    rows = np.clip(np.rint((local[used, 1] - relief.origin[1]) / relief.pixel).astype(int), 0, len(relief.height) - 1)
    columns = np.rint((local[used, 0] - relief.origin[0]) / relief.pixel).astype(int)
    columns = np.clip(columns, 0, relief.height.shape[1] - 1)
    used = used[np.abs(relief.height[rows, columns] - local[used, 2]) < OUTSIDE]
    if not len(used):
        return np.zeros((0, 2), dtype=np.int64)
    pairs = np.asarray(used[cKDTree(local[used]).query_pairs(TOGETHER, output_type="ndarray")], dtype=np.int64)
    ends = edge_table(faces).ends.astype(np.int64)
    key, edge = (np.sort(rows, axis=1) @ (len(local), 1) for rows in (pairs.reshape(-1, 2), ends))
    return pairs.reshape(-1, 2)[~np.isin(key, edge)]


def _grown_together(members: np.ndarray, place: np.ndarray, edges: np.ndarray, doubled: np.ndarray) -> np.ndarray:
    """Vertices that are neighbours of both lips, but not on the line: the corners of the mouth are."""
    on_line = np.isin(place, members)
    both = np.concatenate([edges, edges[:, ::-1]])
    both = both[on_line[both[:, 0]] & ~doubled[place[both[:, 1]]]]
    # A neighbour of both lips is one that several vertices of a place have an edge to.
    row = np.unique(both, axis=0)
    _, index, count = np.unique(
        np.stack([place[row[:, 0]], row[:, 1]], axis=1), axis=0, return_index=True, return_counts=True
    )
    return np.unique(row[index[count > 1], 1])


def _divides(members: np.ndarray, local: np.ndarray, place: np.ndarray, faces: np.ndarray) -> bool:
    """Whether the vertices at most places belong to faces above the line, and to others below it."""
    on_line = np.isin(place, members)
    corner = faces.ravel()
    chosen = on_line[corner]
    vertex = corner[chosen]
    height = np.repeat(local[faces].mean(axis=1)[:, 1], 3)[chosen] - local[vertex, 1]
    mean = np.bincount(vertex, height, len(local)) / np.maximum(np.bincount(vertex, minlength=len(local)), 1)
    touched = np.unique(vertex)
    highest, lowest = np.full(len(local), -np.inf), np.full(len(local), np.inf)
    np.maximum.at(highest, place[touched], mean[touched])
    np.minimum.at(lowest, place[touched], mean[touched])
    parted = (highest[members] > 0.0) & (lowest[members] < 0.0)
    return bool(parted.mean() > 0.5)
