"""The faces of levels of one forest, each found from the level before: only where clusters changed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from warpqem.decimation.decimate import DecimatedMesh
from warpqem.decimation.pruning import DropRecord
from warpqem.mesh.grouping import faces_where

__all__ = ["LevelFaces"]

# Vertices whose faces are looked at at once: new memory for all of them takes longer than the rest.
VERTICES_AT_ONCE = 2048


class LevelFaces:
    """The faces that each level leaves, on the host, which knows what decides them.

    A face that is left goes on as long as its corners stay apart. One that was not is left again only where two of its
    corners come apart: it has one that parts from the vertex that it had collapsed into.

    Args:
        faces: (N, 3) int32, the input's.
        at: finds the faces that have one of some vertices (m,), in any order and as often as there are corners.
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
        self,
        root: np.ndarray,
        changed: npt.NDArray[np.integer],
        before: npt.NDArray[np.integer],
        drops: DropRecord,
    ) -> tuple[np.ndarray, np.ndarray]:
        """What :func:`warpqem.decimation.faces_left.faces_left` gives for a level.

        Args:
            root: (V,) int32, the vertex that each input vertex collapsed into.
            changed: (n,) int, the vertices that did not do so in the level before.
            before: (n,) int, what they had collapsed into there.
            drops: the pruned components.
        """
        dropped, were_dropped = _dropped(drops), self._dropped
        apart = changed[root.take(changed) != root.take(before)]
        is_open = np.zeros(len(root), dtype=bool)
        is_open[before] = True
        if dropped is not None or were_dropped is not None:
            other = np.flatnonzero(_at_vertices(dropped, len(root)) != _at_vertices(were_dropped, len(root)))
            is_open[root.take(other)] = True
            apart = np.concatenate([apart, other])
        self._dropped = dropped
        if is_open.any():
            self._renew(apart, is_open, root)
        return self._faces, self._face_map

    @property
    def is_kept(self) -> npt.NDArray[np.bool_]:
        """(V,) bool, the vertices of the level that was asked for last."""
        return self._corner_count > 0

    def _renew(self, apart: npt.NDArray[np.integer], is_open: npt.NDArray[np.bool_], root: np.ndarray) -> None:
        """Renew the list where clusters changed that went by some vertices, (V,) bool, and vertices (n,) parted."""
        row = faces_where(self._faces, is_open.take)
        self._count_corners(self._faces.take(row, axis=0), -1)
        corner_root, stays = self._looked_at(self._face_map.take(row), root)
        gone, on = row[~stays], corner_root[stays]
        added = self._added(apart, root)
        new, _ = self._looked_at(added, root)
        self._count_corners(on, 1)
        self._count_corners(new, 1)
        self._is_left[self._face_map.take(gone)] = False
        self._is_left[added] = True
        faces = self._faces.copy()
        faces[row[stays]] = on
        self._faces = self._exchanged(faces, gone, added, new) if len(gone) or len(added) else faces

    def _looked_at(
        self, face: npt.NDArray[np.integer], root: np.ndarray
    ) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.bool_]]:
        """The corners of some faces (n,) over roots, (n, 3), and which of them are left, (n,)."""
        corner = self._input.take(face, axis=0)
        corner_root = root.take(corner)
        a, b, c = corner_root.T
        is_left = (a != b) & (b != c) & (c != a)
        if self._dropped is not None:
            is_left &= ~self._dropped.take(corner[:, 0])
        return corner_root, is_left

    def _added(self, apart: npt.NDArray[np.integer], root: np.ndarray) -> npt.NDArray[np.int32]:
        """The faces at vertices (n,) that were not left and are, each once, ascending."""
        found: list[npt.NDArray[np.integer]] = [np.empty(0, dtype=np.int32)]
        for first in range(0, len(apart), VERTICES_AT_ONCE):
            face = self._at(apart[first : first + VERTICES_AT_ONCE])
            face = face[~self._is_left.take(face)]
            found.append(face[self._looked_at(face, root)[1]])
        return np.unique(np.concatenate(found)).astype(np.int32)

    def _exchanged(
        self, faces: np.ndarray, gone: npt.NDArray[np.integer], added: npt.NDArray[np.int32], new: np.ndarray
    ) -> np.ndarray:
        """The list (M, 3) without rows (n,), and with faces (m,) and their corners (m, 3), so that it ascends."""
        if not len(faces):
            self._face_map = added
            return new
        stays = np.ones(len(faces), dtype=bool)
        stays[gone] = False
        row = np.flatnonzero(stays)
        place = np.searchsorted(self._face_map.take(row), added) + np.arange(len(added))
        is_old = np.ones(len(row) + len(added), dtype=bool)
        is_old[place] = False
        # Rows are taken three times as fast as put; those between are put in afterwards.
        source = np.zeros(len(is_old), dtype=np.intp)
        source[is_old] = row
        faces, self._face_map = faces.take(source, axis=0), self._face_map.take(source)
        faces[place], self._face_map[place] = new, added
        return faces

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
