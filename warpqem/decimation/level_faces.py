"""The faces of levels of one forest, each found from the level before: only where clusters changed."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from warpqem.decimation.decimate import DecimatedMesh
from warpqem.decimation.pruning import DropRecord

__all__ = ["LevelFaces"]


class LevelFaces:
    """The faces that each level leaves, on the host, which knows what decides them.

    Args:
        faces: (N, 3) int32, the input's.
        start: (V+1,) int32, where the faces of each vertex begin in ``around``.
        around: (3N,) int32, the faces around one vertex after the other.
        ordered: the level that the first one is near to.
    """

    def __init__(
        self, faces: np.ndarray, start: npt.NDArray[np.int32], around: npt.NDArray[np.int32], ordered: DecimatedMesh
    ) -> None:
        self._faces, self._start, self._around = faces, start, around
        self._root, self._dropped = ordered.root, _dropped(ordered.drops, len(ordered.root))
        self._is_left = np.zeros(len(faces), dtype=bool)
        self._is_left[ordered.face_map] = True

    def at(self, root: np.ndarray, drops: DropRecord) -> tuple[np.ndarray, np.ndarray]:
        """What :func:`warpqem.decimation.faces_left.faces_left` gives for a level.

        Args:
            root: (V,) int32, the vertex that each input vertex collapsed into.
            drops: the pruned components.
        """
        dropped = _dropped(drops, len(root))
        face = self._faces_at(np.flatnonzero((root != self._root) | (dropped != self._dropped)))
        corner = self._faces[face]
        a, b, c = root[corner].T
        self._is_left[face] = (a != b) & (b != c) & (c != a) & ~dropped[corner[:, 0]]
        self._root, self._dropped = root, dropped
        face_map = np.flatnonzero(self._is_left).astype(np.int32)
        return root[self._faces[face_map]], face_map

    def _faces_at(self, vertex: npt.NDArray[np.integer]) -> npt.NDArray[np.int32]:
        """The faces at some vertices, some of them several times."""
        first, count = self._start[vertex], np.diff(self._start)[vertex]
        place = np.arange(int(count.sum())) + np.repeat(first - np.cumsum(count) + count, count)
        return self._around[place]


def _dropped(drops: DropRecord, vertex_count: int) -> npt.NDArray[np.bool_]:
    """(V,) bool, vertices of components that were pruned."""
    if not len(drops):
        return np.zeros(vertex_count, dtype=bool)
    dropped: npt.NDArray[np.bool_] = drops.vertex_drop >= 0
    return dropped
