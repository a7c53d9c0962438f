"""The log of collapses read backwards: vertex splits of a base mesh (Hoppe 1996, for all frames at once).

Input vertices are ranked so that every vertex that ever was stands for consecutive ranks: a collapse keeps the ranks of
the vertex that goes on before those of the one that ends. A corner of a face is one rank for good, and the vertex it
has on a level is the one whose ranks hold it. So faces need no change when a vertex splits.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from warpqem.decimation.collapse_log import CollapseRecord

__all__ = ["SplitTopology"]


@dataclass(frozen=True)
class SplitTopology:
    """A base mesh of B vertices and the C vertex splits that lead back to the input.

    Vertices are rows: the base ones by input vertex, then two for each split, of the vertex that went on and of the one
    that ended. Row r >= B is there from split ``(r - B) // 2`` on.

    Attributes:
        base_count: B.
        row_vertex: (B + 2 C,) int32, the input vertex that each row goes by.
        row_start: (B + 2 C,) int32, its lowest rank.
        parent_row: (C,) int32, the row that each split ends.
        row_end: (B + 2 C,) int32, the split that ends a row; C for those of the input itself.
        face_rank: (N, 3) int32, ranks of the corners, those of the base mesh first, then as splits bring them.
        face_index: (N,) int32, the caller's index of each face.
        face_split: (N,) int32, the split that brings it, -1 for the base mesh.
        error: (C + 1,) float32, the error after so many splits, in diagonals: the largest of the collapses below.
        vertex_count: input vertices V.
        face_count: input faces N; fewer are in the arrays where not all splits are loaded.
    """

    base_count: int
    row_vertex: np.ndarray
    row_start: np.ndarray
    parent_row: np.ndarray
    row_end: np.ndarray
    face_rank: np.ndarray
    face_index: np.ndarray
    face_split: np.ndarray
    error: np.ndarray
    vertex_count: int
    face_count: int

    @property
    def split_count(self) -> int:
        """Splits C."""
        return len(self.parent_row)

    def face_counts(self) -> np.ndarray:
        """(C + 1,) int, faces after so many splits."""
        return np.searchsorted(self.face_split, np.arange(self.split_count + 1), side="left")

    @classmethod
    def from_log(
        cls, faces: np.ndarray, face_index: np.ndarray, vertex_count: int, log: CollapseRecord
    ) -> SplitTopology:
        """Read a log backwards.

        Args:
            faces: (N, 3) int32, the input's faces.
            face_index: (N,) int32, the caller's index of each.
            vertex_count: input vertices V, those without a face included.
            log: its collapses.
        """
        count = len(log)
        rounds = _rounds(log)
        node_of = np.arange(vertex_count)
        size = np.ones(vertex_count + count, dtype=np.int64)
        child = np.empty((count, 2), dtype=np.int64)
        for part in rounds:
            kept, removed = log.kept[part], log.removed[part]
            child[part] = np.stack([node_of[kept], node_of[removed]], axis=1)
            merged = vertex_count + np.arange(part.start, part.stop)
            size[merged] = size[child[part]].sum(axis=1)
            node_of[kept] = merged
        alive = np.zeros(vertex_count, dtype=bool)
        alive[faces] = True
        alive[log.removed] = False
        base_vertex = np.flatnonzero(alive)
        base_node = node_of[base_vertex]
        start = np.zeros(vertex_count + count, dtype=np.int64)
        start[base_node] = np.cumsum(size[base_node]) - size[base_node]
        for part in reversed(rounds):
            whole = start[vertex_count + np.arange(part.start, part.stop)]
            start[child[part, 0]] = whole
            start[child[part, 1]] = whole + size[child[part, 0]]
        # Split j undoes collapse C - 1 - j.
        backwards = np.arange(count)[::-1]
        row_node = np.concatenate([base_node, child[backwards].ravel()])
        row_of = np.empty(vertex_count + count, dtype=np.int64)
        row_of[row_node] = np.arange(len(row_node))
        parent_row = row_of[vertex_count + backwards]
        row_end = np.full(len(row_node), count, dtype=np.int32)
        row_end[parent_row] = np.arange(count)
        split_vertex = np.stack([log.kept, log.removed], axis=1)[backwards].ravel()
        face_split = count - 1 - _last_collapses(faces, log, rounds)
        order = np.lexsort((face_index, face_split))
        return cls(
            base_count=len(base_vertex),
            row_vertex=np.concatenate([base_vertex, split_vertex]).astype(np.int32),
            row_start=start[row_node].astype(np.int32),
            parent_row=parent_row.astype(np.int32),
            row_end=row_end,
            face_rank=start[faces[order]].astype(np.int32),
            face_index=face_index[order].astype(np.int32),
            face_split=face_split[order].astype(np.int32),
            error=np.concatenate([[0.0], np.maximum.accumulate(log.error)])[::-1].astype(np.float32),
            vertex_count=vertex_count,
            face_count=len(faces),
        )


def _rounds(log: CollapseRecord) -> list[slice]:
    """The collapses of each round: no two of them share a vertex."""
    first = np.flatnonzero(np.diff(log.round_index, prepend=-1))
    ends = np.append(first, len(log))
    return [slice(int(a), int(b)) for a, b in itertools.pairwise(ends)]


def _last_collapses(faces: np.ndarray, log: CollapseRecord, rounds: list[slice]) -> np.ndarray:
    """(N,) int, the collapse that takes each face; the number of collapses for those that are left."""
    last = np.full(len(faces), len(log), dtype=np.int64)
    live, corner = np.arange(len(faces)), faces.astype(np.int64)
    vertex_count = int(faces.max()) + 1
    for part in rounds:
        parent, collapse = np.arange(vertex_count), np.full(vertex_count, -1)
        parent[log.removed[part]] = log.kept[part]
        collapse[log.removed[part]] = np.arange(part.start, part.stop)
        # A face goes with the corner whose vertex becomes that of another corner.
        onto = parent[corner]
        goes = (collapse[corner] >= 0) & ((onto[:, :, None] == corner[:, None, :]).any(axis=2))
        gone = goes.any(axis=1)
        first = goes[gone].argmax(axis=1)
        last[live[gone]] = collapse[corner[gone, first]]
        live, corner = live[~gone], onto[~gone]
    return last
