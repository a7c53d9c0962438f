"""Large meshes rearranged so that neighbours lie close together in memory.

Collapsing edges is a walk from neighbour to neighbour. Where a mesh does not fit the caches and its vertices come in an
order that says nothing about where they are, most of the time goes into waiting for memory.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpqem.decimation.collapse_log import CollapseRecord

__all__ = ["ARRANGED_FACES", "Arrangement", "arrange"]

# Meshes of at least so many faces are rearranged: below it, the rows of one or two blocks of key frames fit the cache.
ARRANGED_FACES = 40_000
# A vertex's cell in each direction: three such numbers fill a 32-bit key.
CELL_BITS = 10


@dataclass(frozen=True)
class Arrangement:
    """Vertices along a space-filling curve, and faces by their first vertex on it.

    Attributes:
        vertex: (V,) int32, the input vertex at each place.
        place: (V,) int32, where each input vertex is.
        face: (N,) int32, the input face at each place. Its corners keep their order.
    """

    vertex: np.ndarray
    place: np.ndarray
    face: np.ndarray

    def rearrange_faces(self, faces: np.ndarray) -> np.ndarray:
        """(N, 3) int32 over the rearranged vertices."""
        return self.place[faces[self.face]]

    def rearrange_corners(self, values: np.ndarray) -> np.ndarray:
        """Values (3N,) of the corners or half-edges."""
        return values.reshape(-1, 3)[self.face].ravel()

    def restore_corners(self, values: np.ndarray) -> np.ndarray:
        """Values (3N,) of the corners or half-edges, as the input has them."""
        restored = np.empty_like(values).reshape(-1, 3)
        restored[self.face] = values.reshape(-1, 3)
        return restored.ravel()

    def restore_log(self, log: CollapseRecord) -> CollapseRecord:
        """The collapses in terms of input vertices."""
        opposites = np.where(log.opposites >= 0, self.vertex[log.opposites], np.int32(-1))
        return CollapseRecord(
            self.vertex[log.kept],
            self.vertex[log.removed],
            opposites,
            log.faces_removed,
            log.cost,
            log.error,
            log.round_index,
            log.recent_error,
        )


def arrange(faces: np.ndarray, position: np.ndarray) -> Arrangement:
    """Sort by Morton code: the bits of a vertex's cell in x, y and z, interleaved.

    Args:
        faces: (N, 3) int32.
        position: (V, 3) float32, one pose of the mesh.
    """
    low = position.min(axis=0)
    extent = float((position.max(axis=0) - low).max())
    cell = (position - low) * np.float32((2**CELL_BITS - 1) / extent if extent > 0 else 0.0)
    spread = _spread_bits()
    x, y, z = (spread[cell[:, axis].astype(np.int32)] for axis in range(3))
    vertex = _order(x | y << 1 | z << 2)
    place = np.empty_like(vertex)
    place[vertex] = np.arange(len(vertex), dtype=np.int32)
    first = place[faces[:, 0]]
    for corner in (1, 2):
        np.minimum(first, place[faces[:, corner]], out=first)
    return Arrangement(vertex, place, _order(first))


def _spread_bits() -> np.ndarray:
    """(2 ** CELL_BITS,) uint32, each number with two zeros between its bits."""
    numbers = np.arange(2**CELL_BITS, dtype=np.uint32)
    spread = np.zeros_like(numbers)
    for bit in range(CELL_BITS):
        spread |= (numbers >> bit & 1) << (3 * bit)
    return spread


def _order(key: np.ndarray) -> np.ndarray:
    """(M,) int32, items by ascending key (M,), equal ones in their order: one sort of plain numbers, no two alike."""
    joined = key.astype(np.uint64) << np.uint64(32)
    joined |= np.arange(len(key), dtype=np.uint64)
    joined.sort()
    return joined.astype(np.uint32).view(np.int32)
