"""Frames in which a mesh is collapsed to a point or a line: no error relative to its size exists there."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from warpqem.errors import DegenerateMeshError
from warpqem.measure.checked_meshes import CheckedMesh

__all__ = [
    "Standing",
    "collapsed_frames",
    "collapsed_in_either",
    "distance_apart",
    "distances_from_hull",
    "sizes",
    "standing_frames",
]

# A mesh no further from a line than so many steps between neighbouring numbers of single precision is that line, or a
# point: weights that sum to one up to rounding spread what a joint of scale 0 moves over a few steps along each axis.
STEPS = 8
# A face lower than this part of its longest edge is a line: single precision leaves about as much.
LINE_HEIGHT = 1e-7
# A face higher than this part of its longest edge is none, however its height is worked out.
WIDE_HEIGHT = 1e-5
# Faces and points that are looked at first, evenly spread: nearly always one of them settles a frame.
FIRST = 64

Flags = npt.NDArray[np.bool_]


def collapsed_frames(
    points: npt.NDArray[Any], faces: npt.NDArray[np.integer], first_face: npt.NDArray[np.integer] | None = None
) -> Flags:
    """Whether all used points of a frame lie on one line or are the same, up to rounding, or no face has an area, (n,).

    Args:
        points: (n, V, 3).
        faces: (N, 3); vertices that none of them uses do not count.
        first_face: (M+1,) where each of several meshes begins, and the last one ends: then it is whether one of them is
            so; None for one mesh.
    """
    if first_face is not None and len(first_face) > 2:
        return _collapsed_meshes(points, faces, first_face)
    few = faces[:: -(-len(faces) // FIRST)]
    stands = np.array([_are_wide(frame, few).any() for frame in points], dtype=bool)
    if stands.all():
        return ~stands
    used = np.unique(faces)
    return np.array([_holds(_is_flat, frame, faces) or _holds(_is_line, frame, used) for frame in points], dtype=bool)


def _collapsed_meshes(
    points: npt.NDArray[Any], faces: npt.NDArray[np.integer], first_face: npt.NDArray[np.integer]
) -> Flags:
    """Whether one of several meshes is collapsed, (n,)."""
    wide = np.array([_are_wide(frame, faces) for frame in points])
    if np.logical_or.reduceat(wide, first_face[:-1], axis=1).all():
        return np.zeros(len(points), dtype=bool)
    parts = [faces[first:last] for first, last in itertools.pairwise(first_face.tolist())]
    collapsed: Flags = np.logical_or.reduce([collapsed_frames(points, part) for part in parts])
    return collapsed


def _are_wide(points: npt.NDArray[Any], faces: npt.NDArray[np.integer]) -> Flags:
    """Whether faces (N, 3) are so wide that points (V, 3) with one of them are surely not collapsed, (N,).

    A face between points that are within a distance of a line is no higher than twice that.
    """
    a, b, c = points[faces.T].astype(np.float64)
    one, two = b - a, c - b
    along, across, between = (np.einsum("fi,fi->f", *pair) for pair in ((one, one), (two, two), (one, two)))
    longest = np.maximum(np.maximum(along, across), along + across + 2.0 * between)
    area = along * across - between**2
    height = 4.0 * _rounding(float(np.abs(points).max()))
    wide: Flags = (area > (WIDE_HEIGHT * longest) ** 2) & (area > height**2 * longest)
    return wide


def _holds(
    is_so: Callable[[npt.NDArray[Any], npt.NDArray[np.integer]], bool],
    points: npt.NDArray[Any],
    parts: npt.NDArray[np.integer],
) -> bool:
    """Whether something is so of all parts of a mesh: if it is of a few."""
    few = parts[:: -(-len(parts) // FIRST)]
    return is_so(points, few) and (len(few) == len(parts) or is_so(points, parts))


def _is_flat(points: npt.NDArray[Any], faces: npt.NDArray[np.integer]) -> bool:
    """Whether each face is a line or a point."""
    a, b, c = points[faces.T].astype(np.float64)
    edges = np.stack([b - a, c - b, a - c])
    longest = (edges**2).sum(axis=2).max(axis=0)
    height_area = np.linalg.norm(np.cross(edges[0], edges[1]), axis=1)
    return bool((height_area <= LINE_HEIGHT * longest).all())


def _is_line(points: npt.NDArray[Any], used: npt.NDArray[np.integer]) -> bool:
    """Whether points in single precision are on one line, or are one point, up to rounding."""
    own = points[used]
    if _Line(own).reach > _rounding(float(np.abs(own).max())):
        return False
    return _is_single(own)


class _Line:
    """A line through the first one of points (V, 3) and the one furthest from it.

    Attributes:
        reach: how far points are from it at most.
    """

    def __init__(self, points: npt.NDArray[Any]) -> None:
        self._first = points[0].astype(np.float64)
        away = points - self._first
        furthest = away[(away**2).sum(axis=1).argmax()]
        self._along = furthest / (np.linalg.norm(furthest) or 1.0)
        place = away @ self._along
        self._low, self._high = float(place.min()), float(place.max())
        self.reach = float(self._distances(away, place).max())

    def _distances(
        self, away: npt.NDArray[np.float64], place: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.floating[Any]]:
        return np.linalg.norm(away - np.outer(place, self._along), axis=1)

    def distances(self, points: npt.NDArray[Any]) -> npt.NDArray[np.floating[Any]]:
        """How far points (n, 3) are from the part of the line that its own points lie along, (n,)."""
        away = points - self._first
        return self._distances(away, np.clip(away @ self._along, self._low, self._high))


def _rounding(reach: float) -> float:
    """What counts as one point where coordinates reach so far."""
    return STEPS * float(np.spacing(np.float32(min(reach, float(np.finfo(np.float32).max)))))


def _is_single(points: npt.NDArray[Any]) -> bool:
    return points.dtype == np.float32 or bool((points.astype(np.float32) == points).all())


def sizes(points: npt.NDArray[Any], of_point: float) -> npt.NDArray[np.float64]:
    """Bounding-box diagonals (n,) of frames (n, V, 3); another length for those that are a point, up to rounding."""
    low, high = (bound.astype(np.float64) for bound in (points.min(axis=1), points.max(axis=1)))
    diagonal: npt.NDArray[np.float64] = np.linalg.norm(high - low, axis=1)
    reach = np.maximum(np.abs(low), np.abs(high)).max(axis=1)
    for frame, own in enumerate(diagonal.tolist()):
        if own == 0.0 or (own <= _rounding(float(reach[frame])) and _is_single(points[frame])):
            diagonal[frame] = of_point
    return diagonal


@dataclass(frozen=True)
class Standing:
    """Two sequences without the frames in which either is collapsed.

    Attributes:
        reference: its other frames.
        test: likewise.
        frames: (K,) int64, their numbers before, ascending.
    """

    reference: CheckedMesh
    test: CheckedMesh
    frames: npt.NDArray[np.int64]

    @property
    def follows(self) -> Flags:
        """(K,) whether the frame before each was the one before it, too."""
        return np.diff(self.frames, prepend=-1) == 1


def collapsed_in_either(reference: CheckedMesh, test: CheckedMesh) -> Flags:
    """(F,) whether one of two sequences of as many frames is collapsed."""
    flat = [collapsed_frames(mesh.points, mesh.faces) for mesh in (reference, test)]
    return flat[0] | flat[1]


def standing_frames(reference: CheckedMesh, test: CheckedMesh) -> Standing:
    """The frames in which neither of two sequences of as many frames is collapsed.

    Raises:
        DegenerateMeshError: there is none.
    """
    both = collapsed_in_either(reference, test)
    if both.all():
        raise DegenerateMeshError("reference or test mesh: collapsed to a point or a line in every frame")
    frames = np.flatnonzero(~both)
    if not both.any():
        return Standing(reference, test, frames)
    left = [replace(mesh, points=mesh.points[frames]) for mesh in (reference, test)]
    return Standing(left[0], left[1], frames)


def distances_from_hull(points: npt.NDArray[Any], others: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """Distances (V,) of points (V, 3) from what others (W, 3) lie in: their bounding box, or a tube about a line.

    So of a line it is the distance from that, up to rounding, and never more than from the nearest one of others.
    """
    outside = np.maximum(others.min(axis=0) - points, points - others.max(axis=0)).astype(np.float64)
    from_box = np.linalg.norm(np.maximum(outside, 0.0), axis=1)
    line = _Line(others)
    distance: npt.NDArray[np.float64] = np.maximum(from_box, line.distances(points) - line.reach)
    return distance


def distance_apart(one: npt.NDArray[Any], other: npt.NDArray[Any]) -> float:
    """How far points (V, 3) of each of two meshes are from what the other's lie in at most.

    Where one of the meshes is a point, this is the Hausdorff distance, which vertices attain; of a line without gaps
    it is the largest distance of the other mesh from it.
    """
    return float(max(distances_from_hull(one, other).max(), distances_from_hull(other, one).max()))
