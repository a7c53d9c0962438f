"""Seams: edges that values on the surface do not cross (UV seams, subset borders, creases, hard edges)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from warpqem.arguments.array_input import first_outside, index_array, is_empty
from warpqem.errors import OptionError
from warpqem.mesh.edges import edge_key

__all__ = ["Seams", "half_edge_ends", "image_marks", "read_seams", "seam_ends"]


@dataclass(frozen=True)
class Seams:
    """Seams of a mesh of V vertices and N faces.

    Attributes:
        half_edge: (3N,) int32, 1 at each half-edge of a seam edge.
        on_seam: (V,) bool, vertices with a seam edge.
        corner: (V,) bool, where a seam ends, forks or meets a border.
    """

    half_edge: np.ndarray
    on_seam: np.ndarray
    corner: np.ndarray


def seam_ends(seams: Any, vertex_count: int) -> np.ndarray:
    """Check seam edges (S, 2): vertices that there are, (S, 2) int64.

    Raises:
        MeshShapeError: another shape or dtype.
        OptionError: there is no such vertex.
    """
    ends = index_array(seams, "seams", ("S", 2), expected="(S, 2) vertex indices")
    outside = first_outside(ends, vertex_count)
    if outside is not None:
        raise OptionError(
            f"seams name vertex {ends[outside]}, but there are {vertex_count} vertices (seam {outside[0]})"
        )
    return ends.astype(np.int64, copy=False)


def read_seams(seams: Any, faces: np.ndarray, vertex_count: int) -> Seams:
    """Check seam edges (S, 2) int, or None for none, and mark them on the faces (N, 3).

    Border edges among them are no seams: nothing lies beyond them.

    Raises:
        MeshShapeError: another shape or dtype.
        OptionError: two vertices without an edge between them.
    """
    if seams is None or is_empty(seams):
        return _no_seams(faces, vertex_count)
    ends = seam_ends(seams, vertex_count)
    if not len(ends):
        return _no_seams(faces, vertex_count)
    tail, head = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    key, index, count = np.unique(edge_key(tail, head, vertex_count), return_inverse=True, return_counts=True)
    wanted = np.unique(edge_key(ends[:, 0], ends[:, 1], vertex_count))
    missing = wanted[~np.isin(wanted, key)]
    if len(missing):
        raise OptionError(
            f"seams: there is no edge between vertices {missing[0] // vertex_count} and {missing[0] % vertex_count}"
        )
    is_seam = np.isin(key, wanted) & (count > 1)
    seam_edges = np.stack([key[is_seam] // vertex_count, key[is_seam] % vertex_count], axis=1)
    border_edges = np.stack([key[count == 1] // vertex_count, key[count == 1] % vertex_count], axis=1)
    degree = np.bincount(seam_edges.ravel(), minlength=vertex_count)
    on_border = np.bincount(border_edges.ravel(), minlength=vertex_count) > 0
    on_seam = degree > 0
    return Seams(is_seam[index].astype(np.int32), on_seam, on_seam & ((degree != 2) | on_border))


def _no_seams(faces: np.ndarray, vertex_count: int) -> Seams:
    none = np.zeros(vertex_count, dtype=bool)
    return Seams(np.zeros(faces.size, dtype=np.int32), none, none)


def half_edge_ends(faces: np.ndarray, half_edge: np.ndarray) -> np.ndarray:
    """The vertices (S, 2) that half-edges (S,) of faces (N, 3) go from and to."""
    corner = faces.ravel()
    return np.stack([corner[half_edge], corner[half_edge - half_edge % 3 + (half_edge + 1) % 3]], axis=1)


def image_marks(ends: np.ndarray, faces: np.ndarray, vertex_count: int) -> np.ndarray:
    """(3N,) int32, 1 at both half-edges of faces (N, 3) that seam edges (S, 2) have become.

    An edge of two that merged is one if either is.
    """
    if not len(ends):
        return np.zeros(faces.size, dtype=np.int32)
    key = edge_key(faces.ravel(), np.roll(faces, -1, axis=1).ravel(), vertex_count)
    return np.isin(key, edge_key(ends[:, 0], ends[:, 1], vertex_count)).astype(np.int32)
