"""Faces whose winding does not say which way they face: both sides of a sheet, and those unlike their neighbours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from warpqem.measure.coincidence import coincident
from warpqem.repair.face_pairing import distinct_faces, pair_faces, turned_faces

__all__ = ["Winding", "read_winding"]

Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Winding:
    """What the winding of the N faces of a mesh says about the way they face.

    Attributes:
        both: (N,) bool, faces on the vertices of another one with the other winding: the two sides of a sheet.
        unlike: (N,) bool, faces that simplifying would turn over, as most faces of their part have the other winding.
    """

    both: Flags
    unlike: Flags

    @property
    def either(self) -> Flags:
        """(N,) bool, faces that may face either way."""
        return self.both | self.unlike


def read_winding(points: npt.NDArray[np.float64], faces: npt.NDArray[np.integer]) -> Winding:
    """Find the faces whose winding says nothing. Vertices at the same place count as one.

    Args:
        points: (V, 3) of the first frame.
        faces: (N, 3).
    """
    corners = coincident(points[None])[faces].astype(np.int32)
    proper = np.flatnonzero((corners != np.roll(corners, -1, axis=1)).all(axis=1))
    both, unlike = np.zeros(len(faces), dtype=bool), np.zeros(len(faces), dtype=bool)
    if not len(proper):
        return Winding(both, unlike)
    corners = corners[proper]
    distinct = distinct_faces(corners)
    kept, has_back = corners[distinct.kept], distinct.back >= 0
    turned = turned_faces(pair_faces(kept, len(points)), ~has_back)
    both[proper], unlike[proper] = _repeats(corners, kept[has_back]), _repeats(corners, kept[turned])
    return Winding(both, unlike)


def _repeats(faces: npt.NDArray[np.int32], some: npt.NDArray[np.int32]) -> Flags:
    """(N,) bool, which faces (N, 3) are on the same three vertices as one of some others (M, 3)."""
    if not len(some):
        return np.zeros(len(faces), dtype=bool)
    _, group = np.unique(np.sort(np.concatenate([faces, some]), axis=1), axis=0, return_inverse=True)
    return np.isin(group.ravel()[: len(faces)], group.ravel()[len(faces) :])
