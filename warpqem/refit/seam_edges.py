"""Seams and borders of the input and what became of them on the output, for the refit to fit one to the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpqem.mesh.edges import edge_key
from warpqem.mesh.seams import half_edge_ends, image_marks

__all__ = ["SeamEdges", "find_borders", "find_seams"]


@dataclass(frozen=True)
class SeamEdges:
    """Seams of a surface of N faces.

    Attributes:
        marks: (3N,) int32, 1 at both half-edges of each; (0,) without any.
        half_edge: int32, one half-edge of each, ascending.
    """

    marks: np.ndarray
    half_edge: np.ndarray

    @classmethod
    def of(cls, faces: np.ndarray, marks: np.ndarray) -> SeamEdges:
        """Those that half-edges of faces (N, 3) are marked for, in (3N,)."""
        half_edge = np.flatnonzero(marks)
        if not len(half_edge):
            return cls(np.zeros(0, dtype=np.int32), half_edge.astype(np.int32))
        ends = half_edge_ends(faces, half_edge)
        _, first = np.unique(edge_key(ends[:, 0], ends[:, 1], int(faces.max()) + 1), return_index=True)
        return cls(marks.astype(np.int32), half_edge[np.sort(first)].astype(np.int32))


def find_seams(
    half_edge: np.ndarray,
    faces: np.ndarray,
    is_left: np.ndarray,
    vertex_map: np.ndarray,
    out_faces: np.ndarray,
    out_count: int,
) -> tuple[SeamEdges, SeamEdges]:
    """Seams of the faces of the input that are left, and of the output; none of either where the output has none.

    Args:
        half_edge: (S,) int, half-edges of seams of the input, both of each edge.
        faces: (N, 3) int32, the input's.
        is_left: (N,) bool, those that are left, which the first seams are of.
        vertex_map: (V,) int32, input vertex to output vertex.
        out_faces: (N', 3) int32.
        out_count: output vertices.
    """
    none = SeamEdges(np.zeros(0, dtype=np.int32), np.zeros(0, dtype=np.int32))
    left = half_edge[is_left[half_edge // 3]]
    if not len(left):
        return none, none
    ends = vertex_map[half_edge_ends(faces, left)]
    output = SeamEdges.of(out_faces, image_marks(ends, out_faces, out_count))
    if not len(output.half_edge):
        # Of a small island none may be left.
        return none, none
    marks = np.zeros(faces.size, dtype=bool)
    marks[left] = True
    every = is_left.all()
    return SeamEdges.of(
        faces if every else faces[is_left], marks if every else marks.reshape(-1, 3)[is_left].ravel()
    ), output


def find_borders(
    half_edge: np.ndarray, is_left: np.ndarray, out_faces: np.ndarray, is_open: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Half-edges without an opposite one: of the faces of the input that are left, and of the output, int32 ascending.

    Args:
        half_edge: (B,) int, those of the input.
        is_left: (N,) bool, faces of the input that are left; their components are whole.
        out_faces: (N', 3) int32.
        is_open: (C,) bool, output vertices at which such half-edges of the output may be.
    """
    left = half_edge
    if not is_left.all():
        face, corner = np.divmod(half_edge, 3)
        there = is_left[face]
        left = 3 * (np.cumsum(is_left) - 1)[face[there]] + corner[there]
    at_corner = is_open[out_faces]
    own = np.flatnonzero(at_corner & at_corner[:, [1, 2, 0]])
    tail, head = half_edge_ends(out_faces, own).astype(np.int64).T
    count = len(is_open)
    alone = own[~np.isin(tail * count + head, head * count + tail)]
    return left.astype(np.int32), alone.astype(np.int32)
