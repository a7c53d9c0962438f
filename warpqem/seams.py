"""Seams: edges that values on the surface do not cross (UV seams, subset borders, creases, hard edges)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from warpqem.edges import edge_key
from warpqem.errors import MeshShapeError, OptionError
from warpqem.mesh_input import as_numpy

__all__ = ["Seams", "read_seams"]


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


def read_seams(seams: Any, faces: np.ndarray, vertex_count: int) -> Seams:
    """Check seam edges (S, 2) int, or None for none, and mark them on the faces (N, 3).

    Border edges among them are no seams: nothing lies beyond them.

    Raises:
        MeshShapeError: another shape or dtype.
        OptionError: two vertices without an edge between them.
    """
    if seams is None:
        none = np.zeros(vertex_count, dtype=bool)
        return Seams(np.zeros(faces.size, dtype=np.int32), none, none)
    ends = as_numpy(seams)
    if ends.ndim != 2 or ends.shape[1] != 2 or ends.dtype.kind not in "iu":
        raise MeshShapeError(f"seams must be (S, 2) vertex indices, got shape {ends.shape} dtype {ends.dtype}")
    outside = (ends < 0) | (ends >= vertex_count)
    if outside.any():
        raise OptionError(f"seams name vertex {ends[outside][0]}, but there are {vertex_count} vertices")
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
