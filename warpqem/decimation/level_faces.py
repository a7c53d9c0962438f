"""The faces of levels of one forest, each found from the level before: only where clusters changed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from warpqem.decimation.decimate import DecimatedMesh
from warpqem.decimation.pruning import DropRecord

__all__ = ["LevelFaces"]

# Faces that are looked at at once: new memory for all of them takes longer than the rest.
AT_ONCE = 8192


class LevelFaces:
    """The faces that each level leaves, on the host, which knows what decides them.

    Args:
        faces: (N, 3) int32, the input's.
        at: finds the faces (n,), ascending, that have one of some vertices (m,).
        ordered: the level that the first one is near to.
    """

    def __init__(
        self,
        faces: np.ndarray,
        at: Callable[[npt.NDArray[np.integer]], npt.NDArray[np.integer]],
        ordered: DecimatedMesh,
    ) -> None:
        self._input, self._at = faces, at
        self._dropped = _dropped(ordered.drops)
        # Those that are left, over roots, and which of the input's they are.
        self._faces, self._face_map = ordered.faces, ordered.face_map
        self._is_left = np.zeros(len(faces), dtype=bool)
        self._is_left[self._face_map] = True
        self._corner_count = np.zeros(len(ordered.root), dtype=np.int32)
        self._count_corners(self._faces, 1)

    def at(
        self, root: np.ndarray, changed: npt.NDArray[np.integer], drops: DropRecord
    ) -> tuple[np.ndarray, np.ndarray]:
        """What :func:`warpqem.decimation.faces_left.faces_left` gives for a level.

        Args:
            root: (V,) int32, the vertex that each input vertex collapsed into.
            changed: (n,) int, the vertices that did not do so in the level before.
            drops: the pruned components.
        """
        dropped = _dropped(drops)
        if dropped is not None or self._dropped is not None:
            is_changed = _at_vertices(dropped, len(root)) != _at_vertices(self._dropped, len(root))
            changed = np.union1d(changed, np.flatnonzero(is_changed))
        self._dropped = dropped
        face = self._at(changed)
        if len(face):
            self._look_at(face, root, dropped)
        return self._faces, self._face_map

    @property
    def is_kept(self) -> npt.NDArray[np.bool_]:
        """(V,) bool, the vertices of the level that was asked for last."""
        return self._corner_count > 0

    def _look_at(self, face: npt.NDArray[np.integer], root: np.ndarray, dropped: npt.NDArray[np.bool_] | None) -> None:
        """Put some faces (n,) of the input, ascending, in the list as they are now, or take them out."""
        is_left, found = self._left_of(face, root, dropped)
        was_left = self._is_left.take(face)
        self._is_left[face] = is_left
        old = np.searchsorted(self._face_map, face[was_left].astype(np.int32))
        self._count_corners(self._faces.take(old, axis=0), -1)
        stays = np.ones(len(self._face_map), dtype=bool)
        stays[old] = False
        face_map = np.flatnonzero(self._is_left).astype(np.int32)
        new = np.searchsorted(face_map, face[is_left].astype(np.int32))
        is_old = np.ones(len(face_map), dtype=bool)
        is_old[new] = False
        # Rows of the faces that are not looked at go on; those between them are put in afterwards.
        place = np.zeros(len(face_map), dtype=np.intp)
        place[is_old] = np.flatnonzero(stays)
        faces = self._faces.take(place, axis=0) if len(self._faces) else np.empty((len(face_map), 3), dtype=np.int32)
        faces[new] = found
        self._count_corners(found, 1)
        self._faces, self._face_map = faces, face_map

    def _left_of(
        self, face: npt.NDArray[np.integer], root: np.ndarray, dropped: npt.NDArray[np.bool_] | None
    ) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.int32]]:
        """Which of some faces (n,) are left, (n,) bool, and the corners of these over roots, (m, 3) int32."""
        is_left, found = np.empty(len(face), dtype=bool), []
        for first in range(0, len(face), AT_ONCE):
            corner = self._input.take(face[first : first + AT_ONCE], axis=0)
            corner_root = root.take(corner)
            a, b, c = corner_root.T
            left = (a != b) & (b != c) & (c != a)
            if dropped is not None:
                left &= ~dropped.take(corner[:, 0])
            is_left[first : first + AT_ONCE] = left
            found.append(corner_root.take(np.flatnonzero(left), axis=0))
        return is_left, np.concatenate(found)

    def _count_corners(self, faces: np.ndarray, each: int) -> None:
        """Add ``each`` for every corner of faces (n, 3) at its vertex."""
        # A number of the same type is added ten times as fast.
        np.add.at(self._corner_count, faces.ravel(), np.int32(each))


def _dropped(drops: DropRecord) -> npt.NDArray[np.bool_] | None:
    """(V,) bool, vertices of components that were pruned; None for none."""
    if not len(drops):
        return None
    dropped: npt.NDArray[np.bool_] = drops.vertex_drop >= 0
    return dropped


def _at_vertices(dropped: npt.NDArray[np.bool_] | None, count: int) -> npt.NDArray[np.bool_]:
    return np.zeros(count, dtype=bool) if dropped is None else dropped
