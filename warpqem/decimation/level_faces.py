"""The faces of levels of one forest, each found from the level before: only where clusters changed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from warpqem.decimation.decimate import DecimatedMesh
from warpqem.decimation.pruning import DropRecord

__all__ = ["LevelFaces"]


class LevelFaces:
    """The faces that each level leaves, on the host, which knows what decides them.

    Args:
        faces: (N, 3) int32, the input's.
        at: finds the faces (n,), ascending, that have one of some vertices, (V,) bool.
        ordered: the level that the first one is near to.
    """

    def __init__(
        self,
        faces: np.ndarray,
        at: Callable[[npt.NDArray[np.bool_]], npt.NDArray[np.integer]],
        ordered: DecimatedMesh,
    ) -> None:
        self._faces, self._at = faces, at
        self._root, self._dropped = ordered.root, _dropped(ordered.drops, len(ordered.root))
        self._is_left = np.zeros(len(faces), dtype=bool)
        self._is_left[ordered.face_map] = True
        # Of the faces that are left.
        self._corners = np.empty((len(faces), 3), dtype=np.int32)
        self._corners[ordered.face_map] = ordered.faces

    def at(self, root: np.ndarray, drops: DropRecord) -> tuple[np.ndarray, np.ndarray]:
        """What :func:`warpqem.decimation.faces_left.faces_left` gives for a level.

        Args:
            root: (V,) int32, the vertex that each input vertex collapsed into.
            drops: the pruned components.
        """
        dropped = _dropped(drops, len(root))
        face = self._at((root != self._root) | (dropped != self._dropped))
        corner = self._faces[face]
        self._corners[face] = corner_root = root[corner]
        a, b, c = corner_root.T
        self._is_left[face] = (a != b) & (b != c) & (c != a) & ~dropped[corner[:, 0]]
        self._root, self._dropped = root, dropped
        face_map = np.flatnonzero(self._is_left).astype(np.int32)
        return self._corners.take(face_map, axis=0), face_map


def _dropped(drops: DropRecord, vertex_count: int) -> npt.NDArray[np.bool_]:
    """(V,) bool, vertices of components that were pruned."""
    if not len(drops):
        return np.zeros(vertex_count, dtype=bool)
    dropped: npt.NDArray[np.bool_] = drops.vertex_drop >= 0
    return dropped
