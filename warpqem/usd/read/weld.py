"""Join vertices that were split only so that values on the two sides of an edge can differ."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

from warpqem.mesh.components import lowest_members
from warpqem.mesh.edges import edge_key

__all__ = ["weld"]


def weld(faces: npt.NDArray[np.int32], arrays: Iterable[npt.NDArray[Any]]) -> npt.NDArray[np.int32]:
    """Find the vertex that each vertex becomes when coinciding border edges are sewn together.

    Two border edges are sewn where their ends agree in all arrays, they run in opposite directions, and no third edge
    lies there. So no edge gets a third face, no two parts that only touch at a point are joined, and the two sides of
    a double-sided sheet stay apart. Faces with two corners in one place, as modelling tools leave them in cracks, do
    not count where sewing closes them: they have no area, and as faces they would hold their neighbours apart.

    Args:
        faces: int32, shape (N, 3), vertices of each triangle.
        arrays: (V, ...) each, what must be equal: points in every frame, joint influences, blend-shape offsets. They
            are looked at one after the other, and no more of them than it takes to find all vertices different.

    Returns:
        int32, shape (V,), the lowest vertex among those that are joined. A face that sewing closes has one of them at
        two of its corners.
    """
    vertex_count = int(faces.max()) + 1
    itself = np.arange(vertex_count, dtype=np.int32)
    alike = _alike(vertex_count, arrays)
    if (alike == itself).all():
        return itself
    corners = alike[faces]
    sliver = (corners == np.roll(corners, 1, axis=1)).any(axis=1)
    open_faces = faces[~sliver]
    tail, head = open_faces.ravel(), np.roll(open_faces, -1, axis=1).ravel()
    _, edge, face_count = np.unique(edge_key(tail, head, vertex_count), return_inverse=True, return_counts=True)
    on_border = face_count[edge.ravel()] == 1
    border_vertices = np.unique(np.append(tail[on_border], head[on_border]))
    if not len(border_vertices):
        return itself
    place = np.arange(vertex_count, dtype=np.int64)
    _, lowest, group = np.unique(alike[border_vertices], return_index=True, return_inverse=True)
    place[border_vertices] = border_vertices[lowest][group.ravel()]
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


def _alike(vertex_count: int, arrays: Iterable[npt.NDArray[Any]]) -> npt.NDArray[np.int64]:
    """For each vertex the lowest one that agrees with it in all arrays.

    The first array leaves few vertices that have a like, and only these are looked at in the others.
    """
    label = np.arange(vertex_count, dtype=np.int64)
    member: npt.NDArray[np.int64] | None = None
    for array in arrays:
        rows = array[:vertex_count].reshape(vertex_count, -1)
        if member is None:
            member = np.flatnonzero(_has_like(rows))
            if not len(member):
                break
            label[member] = 0
        elif (rows[member] == rows[label[member]]).all():
            continue
        label[member] = _split(label[member], rows[member], member)
        _, group, size = np.unique(label[member], return_inverse=True, return_counts=True)
        member = member[size[group.ravel()] > 1]
        if not len(member):
            break
    return label


def _has_like(rows: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    """Which rows may be equal to another one: those with the same hash as another."""
    # Adding nought makes the two zeros of floating-point numbers one.
    bits = (rows.astype(np.float64) + 0.0).view(np.uint64)
    code = np.zeros(len(rows), dtype=np.uint64)
    for column in bits.T:
        # Multiplying by an odd constant and folding the high bits back (Steele, Lea and Flood 2014, splitmix64).
        code = (code ^ column) * np.uint64(0xBF58476D1CE4E5B9)
        code ^= code >> np.uint64(29)
    ordered = np.sort(code)
    repeated = ordered[1:][ordered[1:] == ordered[:-1]]
    # Most meshes have none, which takes half as long to see.
    return np.isin(code, repeated) if len(repeated) else np.zeros(len(rows), dtype=bool)


def _split(
    label: npt.NDArray[np.int64], rows: npt.NDArray[Any], vertex: npt.NDArray[np.int64]
) -> npt.NDArray[np.int64]:
    """New labels where rows with one label differ: the lowest vertex of those whose rows are equal."""
    order = np.lexsort((vertex, *rows.T, label))
    ordered = rows[order]
    differs = (label[order][1:] != label[order][:-1]) | (ordered[1:] != ordered[:-1]).any(axis=1)
    start = np.flatnonzero(np.append(True, differs))
    lowest = np.repeat(vertex[order[start]], np.diff(np.append(start, len(order))))
    split = np.empty_like(label)
    split[order] = lowest
    return split
