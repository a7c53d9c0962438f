"""Undirected edges of a triangle mesh with their wings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from warpqem.mesh.grouping import order_by

__all__ = ["EdgeTable", "corner_links", "edge_key", "edge_table", "faces_across"]


@dataclass(frozen=True)
class EdgeTable:
    """Edges in ascending order of their ends.

    Attributes:
        ends: (E, 2) int32, lower vertex first.
        wings: (E, 2) int32, the vertices opposite the edge in its first and last face, so that the first face
            runs ``ends[0] -> ends[1]`` where the faces are consistently oriented; the second is -1 at a border.
        face_count: (E,) int32, faces at the edge.
    """

    ends: np.ndarray
    opposites: np.ndarray
    face_count: np.ndarray


def edge_key(tail: np.ndarray, head: np.ndarray, vertex_count: int) -> np.ndarray:
    """One int64 for each undirected edge of a mesh of ``vertex_count`` vertices, ascending by its ends."""
    return np.minimum(tail, head).astype(np.int64) * vertex_count + np.maximum(tail, head)


def corner_links(faces: np.ndarray, key: np.ndarray, joins: np.ndarray) -> np.ndarray:
    """Pairs (L, 2) int64 of corners, from 0 to 3N, at one vertex of two faces on either side of an edge.

    Args:
        faces: (N, 3) int.
        key: (3N,) int64, :func:`edge_key` of the edges from each corner to the next.
        joins: (3N,) bool, edges that count.
    """
    order = order_by(key, int(key.max(initial=0)) + 1)
    order = order[joins[order]]
    pair = np.flatnonzero(key[order[1:]] == key[order[:-1]])
    first, second = order[pair], order[pair + 1]
    # The corner after each one in its face, at the other end of the edge.
    after = np.arange(faces.size).reshape(-1, 3)[:, [1, 2, 0]].ravel()
    tail = faces.ravel()
    same = tail[first] == tail[second]
    return np.concatenate(
        [
            np.stack([first, np.where(same, second, after[second])], axis=1),
            np.stack([after[first], np.where(same, after[second], second)], axis=1),
        ]
    )


def edge_table(faces: np.ndarray) -> EdgeTable:
    """Edges of ``faces`` (N, 3) int."""
    tail, head, opposite_vertex = faces.ravel(), np.roll(faces, -1, axis=1).ravel(), np.roll(faces, 1, axis=1).ravel()
    low, high = np.minimum(tail, head), np.maximum(tail, head)
    # Half-edges that run from the lower to the higher vertex come first within an edge.
    key = edge_key(tail, head, int(faces.max()) + 1) * 2 + (tail > head)
    order = np.argsort(key, kind="stable")
    key = key[order] >> 1
    first = np.flatnonzero(np.append(True, key[1:] != key[:-1]))
    count = np.diff(np.append(first, len(key)))
    last = first + count - 1
    ends = np.stack([low[order[first]], high[order[first]]], axis=1)
    opposites = np.stack([opposite_vertex[order[first]], np.where(count > 1, opposite_vertex[order[last]], -1)], axis=1)
    return EdgeTable(ends.astype(np.int32), opposites.astype(np.int32), count.astype(np.int32))


def faces_across(faces: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """(3N,) int32, for the edge from each corner to the next the face beyond it, of several one; -1 at a border."""
    tail, head = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    key = edge_key(tail, head, int(faces.max(initial=0)) + 1)
    order = np.argsort(key, kind="stable")
    same = key[order][1:] == key[order][:-1]
    across = np.full(len(key), -1, dtype=np.int32)
    across[order[:-1][same]] = order[1:][same] // 3
    across[order[1:][same]] = order[:-1][same] // 3
    return across
