"""Join vertices that were split only so that values on the two sides of an edge can differ."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

from warpqem.components import lowest_members
from warpqem.edges import edge_key

__all__ = ["weld"]


def weld(faces: npt.NDArray[np.int32], arrays: Iterable[npt.NDArray[Any]]) -> npt.NDArray[np.int32]:
    """Find the vertex that each vertex becomes when coinciding border edges are sewn together.

    Two border edges are sewn where their ends agree in all arrays, they run in opposite directions, and no third edge
    lies there. So no edge gets a third face, no two parts that only touch at a point are joined, and the two sides of
    a double-sided sheet stay apart. Faces with two corners in one place, as modelling tools leave them in cracks, do
    not count where sewing closes them: they have no area, and as faces they would hold their neighbours apart.

    Args:
        faces: int32, shape (N, 3), vertices of each triangle.
        arrays: (V, ...) each, what must be equal: points in every frame, joint influences, blend-shape offsets.

    Returns:
        int32, shape (V,), the lowest vertex among those that are joined. A face that sewing closes has one of them at
        two of its corners.
    """
    arrays = list(arrays)
    vertex_count = int(faces.max()) + 1
    itself = np.arange(vertex_count, dtype=np.int32)
    sliver = _slivers(faces, arrays)
    open_faces = faces[~sliver]
    tail, head = open_faces.ravel(), np.roll(open_faces, -1, axis=1).ravel()
    _, edge, face_count = np.unique(edge_key(tail, head, vertex_count), return_inverse=True, return_counts=True)
    on_border = face_count[edge.ravel()] == 1
    border_vertices = np.unique(np.append(tail[on_border], head[on_border]))
    if not len(border_vertices):
        return itself
    place = _places(border_vertices, arrays, vertex_count)
    place_key = edge_key(place[tail], place[head], vertex_count)
    order = np.argsort(place_key, kind="stable")
    _, start, count = np.unique(place_key[order], return_index=True, return_counts=True)
    first, second = order[start[count == 2]], order[start[count == 2] + 1]
    sewn = on_border[first] & on_border[second]
    sewn &= (place[tail[first]] == place[head[second]]) & (place[tail[first]] != place[head[first]])
    first, second = first[sewn], second[sewn]
    links = np.stack([np.append(tail[first], head[first]), np.append(head[second], tail[second])], axis=1)
    joined = lowest_members(vertex_count, links).astype(np.int32)
    corners = joined[faces[sliver]]
    still_open = (corners != np.roll(corners, 1, axis=1)).all(axis=1)
    # A sliver that is still a face needs edges of its own.
    return np.where(np.isin(joined, corners[still_open]), itself, joined).astype(np.int32)


def _slivers(faces: npt.NDArray[np.int32], arrays: list[npt.NDArray[Any]]) -> npt.NDArray[np.bool_]:
    """(N,) whether two corners of a face agree in all arrays."""
    tail, head = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    edge = np.arange(len(tail))
    for array in arrays:
        same = array[tail[edge]] == array[head[edge]]
        edge = edge[same.all(axis=tuple(range(1, same.ndim)))]
    sliver = np.zeros(len(faces), dtype=bool)
    sliver[edge // 3] = True
    return sliver


def _places(
    chosen: npt.NDArray[np.int32], arrays: Iterable[npt.NDArray[Any]], vertex_count: int
) -> npt.NDArray[np.int64]:
    """For each vertex the lowest of the chosen ones that agree with it in all arrays; others are alone."""
    label = np.zeros(len(chosen), dtype=np.int64)
    for array in arrays:
        # Adding nought makes the two zeros of floating-point numbers one.
        values = array[chosen].reshape(len(chosen), -1) + np.zeros(1, dtype=array.dtype)
        _, rank = np.unique(values, axis=0, return_inverse=True)
        _, label = np.unique(label * (len(chosen) + 1) + rank.ravel(), return_inverse=True)
        label = label.ravel()
    place = np.arange(vertex_count, dtype=np.int64)
    _, first = np.unique(label, return_index=True)
    place[chosen] = chosen[first][label]
    return place
