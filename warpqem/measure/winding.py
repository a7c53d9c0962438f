"""Faces whose winding does not say which way they face: both sides of a sheet, and those unlike their neighbours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from warpqem.measure.coincidence import coincident
from warpqem.mesh.components import lowest_members
from warpqem.mesh.edges import edge_key
from warpqem.repair.face_pairing import distinct_faces, pair_faces, runs, turned_faces

__all__ = ["Winding", "read_winding"]

Flags = npt.NDArray[np.bool_]
Doubles = npt.NDArray[np.float64]

# The normals of a patch are one direction where their sum is this part of what it is at most: a polygon may be far from
# flat, but is no surface that closes.
ONE_DIRECTION = 0.5
# A face that is so much lower than long, as where corners of a polygon are in line, faces any way.
SLIVER = 0.1


@dataclass(frozen=True)
class Winding:
    """What the winding of the N faces of a mesh says about the way they face.

    Attributes:
        both: (N,) bool, faces with a back, which has the same vertices and the other winding: the two sides of a sheet.
            It is the back of the face itself, or of the polygon that the face is a part of, and cut along other
            diagonals.
        unlike: (N,) bool, faces that simplifying would turn over, as most faces of their part have the other winding.
    """

    both: Flags
    unlike: Flags

    @property
    def either(self) -> Flags:
        """(N,) bool, faces that may face either way."""
        return self.both | self.unlike


def read_winding(
    points: npt.NDArray[np.float64], faces: npt.NDArray[np.integer], mesh: npt.NDArray[np.integer] | None = None
) -> Winding:
    """Find the faces whose winding says nothing. Vertices at the same place count as one.

    Args:
        points: (V, 3) of the first frame.
        faces: (N, 3).
        mesh: (V,) which of several meshes each vertex is of; None for one.
    """
    places = points if mesh is None else np.concatenate([points, mesh[:, None]], axis=1)
    corners = coincident(places[None])[faces].astype(np.int32)
    proper = np.flatnonzero((corners != np.roll(corners, -1, axis=1)).all(axis=1))
    both, unlike = np.zeros(len(faces), dtype=bool), np.zeros(len(faces), dtype=bool)
    if not len(proper):
        return Winding(both, unlike)
    corners = corners[proper]
    distinct = distinct_faces(corners)
    kept, has_back = corners[distinct.kept], distinct.back >= 0
    turned = turned_faces(pair_faces(kept, len(points)), ~has_back)
    both[proper], unlike[proper] = _repeats(corners, kept[has_back]), _repeats(corners, kept[turned])
    both[proper[distinct.kept]] |= _have_backs(points.astype(np.float64), kept)
    return Winding(both, unlike)


def _have_backs(points: Doubles, faces: npt.NDArray[np.int32]) -> Flags:
    """(M,) bool, faces (M, 3) of polygons that another polygon goes around the other way, however both are cut.

    Where a sheet has two sides, four faces meet at the edges between its polygons, and two, one of each side, at its
    rim; at a diagonal of a polygon there are two of the same side. So faces that meet in twos, and do not fold back on
    each other, are the polygons, with no vertex inside.
    """
    normal = _normals(points, faces)
    length = np.linalg.norm(normal, axis=1)
    patch, rim = _patches(points, faces, normal, length)
    edge = np.flatnonzero(rim)
    around = patch[edge // 3]
    sides = np.stack([np.bincount(patch, along, minlength=len(faces)) for along in normal.T], axis=1)
    whole = np.bincount(patch, length, minlength=len(faces))
    # A polygon of n corners, cut by diagonals, has n - 2 faces.
    corner_count, face_count = (np.bincount(owner, minlength=len(faces)) for owner in (around, patch))
    polygon = (corner_count - 2 == face_count) & (np.linalg.norm(sides, axis=1) > ONE_DIRECTION * whole)
    tail, head = (ends.ravel()[edge] for ends in (faces, np.roll(faces, -1, axis=1)))
    forward, backward = (np.zeros(len(faces), dtype=np.uint64) for _ in range(2))
    np.add.at(forward, around, _spread(tail, head))
    np.add.at(backward, around, _spread(head, tail))
    backed: Flags = (polygon & np.isin(forward, backward[polygon]))[patch]
    return backed


def _patches(
    points: Doubles, faces: npt.NDArray[np.int32], normal: Doubles, length: Doubles
) -> tuple[npt.NDArray[np.int64], Flags]:
    """(M,) the lowest face of the patch of each face, and (3M,) which half-edges are at the rim of theirs.

    Faces that meet in twos, with the same winding and without folding back on each other, are of one patch. A sliver is
    of that beyond its longest edge: the other two are those of a polygon, or lead to smaller slivers.
    """
    tail, head = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    key = edge_key(tail, head, len(points))
    order = np.argsort(key, kind="stable")
    first, count = runs(key[order])
    pair = first[count == 2]
    one, other = order[pair], order[pair + 1]
    face = [ends // 3 for ends in (one, other)]
    squared = ((points.take(head, axis=0) - points.take(tail, axis=0)) ** 2).sum(axis=1).reshape(-1, 3)
    longest = squared.argmax(axis=1)
    # Twice the area is the height times the longest edge.
    is_sliver = length < SLIVER * squared.max(axis=1)
    slivers = [is_sliver[beside] for beside in face]
    along = [
        sliver & (longest[beside] == edge - 3 * beside)
        for sliver, beside, edge in zip(slivers, face, (one, other), strict=True)
    ]
    is_smooth = (normal.take(face[0], axis=0) * normal.take(face[1], axis=0)).sum(axis=1) > 0
    goes_on = (tail[one] == head[other]) & np.where(slivers[0] | slivers[1], along[0] | along[1], is_smooth)
    rim = np.ones(3 * len(faces), dtype=bool)
    rim[one[goes_on]] = rim[other[goes_on]] = False
    return lowest_members(len(faces), np.stack([beside[goes_on] for beside in face], axis=1)), rim


def _normals(points: Doubles, faces: npt.NDArray[np.int32]) -> Doubles:
    corner = points[faces]
    found: Doubles = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    return found


def _spread(tail: npt.NDArray[np.int32], head: npt.NDArray[np.int32]) -> npt.NDArray[np.uint64]:
    """Numbers (E,) for directed edges, so spread over 64 bits that equal sums of them are sums of the same edges."""
    mixed = tail.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15) + head.astype(np.uint64)
    for factor in (0xBF58476D1CE4E5B9, 0x94D049BB133111EB):
        mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(factor)
    return mixed ^ (mixed >> np.uint64(31))


def _repeats(faces: npt.NDArray[np.int32], some: npt.NDArray[np.int32]) -> Flags:
    """(N,) bool, which faces (N, 3) are on the same three vertices as one of some others (M, 3)."""
    if not len(some):
        return np.zeros(len(faces), dtype=bool)
    _, group = np.unique(np.sort(np.concatenate([faces, some]), axis=1), axis=0, return_inverse=True)
    return np.isin(group.ravel()[: len(faces)], group.ravel()[len(faces) :])
