"""Validity figures of a face list: manifoldness, borders, components, Euler number."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from warpqem.mesh.mesh_input import read_faces

__all__ = ["Topology", "topology", "unique_edges"]


@dataclass(frozen=True)
class Topology:
    """Counts over the vertices, edges and faces that faces refer to.

    Attributes:
        faces: faces.
        vertices: vertices in use.
        edges: undirected edges.
        non_manifold_edges: edges with more than two faces.
        non_manifold_vertices: fans of faces (linked by shared edges) beyond one per vertex, summed over the vertices.
        border_edges: edges with one face.
        components: connected parts, linked by shared vertices.
        euler_number: vertices - edges + faces.
        repeated_faces: faces whose three vertices an earlier face has too, in any order.
        collapsed_faces: faces that name a vertex twice.
    """

    faces: int
    vertices: int
    edges: int
    non_manifold_edges: int
    non_manifold_vertices: int
    border_edges: int
    components: int
    euler_number: int
    repeated_faces: int
    collapsed_faces: int


def unique_edges(
    faces: npt.NDArray[np.int64],
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Undirected edges (E, 2), the edge of every half-edge (3N,) and the number of half-edges per edge (E,).

    Half-edge k * N + f leads from corner k of face f to the next corner.
    """
    start = faces.T.ravel()
    end = faces[:, [1, 2, 0]].T.ravel()
    # One integer per edge sorts an order of magnitude faster than rows; it cannot overflow below 3e9 vertices.
    vertex_count = int(faces.max()) + 1
    key = np.minimum(start, end) * vertex_count + np.maximum(start, end)
    unique, inverse, count = np.unique(key, return_inverse=True, return_counts=True)
    return np.stack([unique // vertex_count, unique % vertex_count], axis=1), inverse.ravel(), count


def _component_labels(count: int, a: npt.NDArray[np.int64], b: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Smallest node of the connected component of each of count nodes, for links between a (L,) and b (L,).

    Hooking and pointer jumping: Shiloach and Vishkin, "An O(log n) Parallel Connectivity Algorithm" (1982).
    """
    label = np.arange(count)
    while True:
        root_a, root_b = label[a], label[b]
        open_links = root_a != root_b
        if not open_links.any():
            return label
        a, b, root_a, root_b = a[open_links], b[open_links], root_a[open_links], root_b[open_links]
        np.minimum.at(label, np.maximum(root_a, root_b), np.minimum(root_a, root_b))
        while not np.array_equal(jumped := label[label], label):
            label = jumped


def _fan_count(faces: npt.NDArray[np.int64], edge_of_half_edge: npt.NDArray[np.int64]) -> int:
    """Number of face fans: classes of corners linked wherever two faces share an edge at their common vertex."""
    face_count = len(faces)
    order = np.argsort(edge_of_half_edge, kind="stable")
    same = edge_of_half_edge[order[:-1]] == edge_of_half_edge[order[1:]]
    half_edges = order[:-1][same], order[1:][same]
    (face_a, corner_a), (face_b, corner_b) = ((h % face_count, h // face_count) for h in half_edges)
    links_a, links_b = [], []
    for end_a in (0, 1):
        for end_b in (0, 1):
            a, b = (corner_a + end_a) % 3, (corner_b + end_b) % 3
            meet = faces[face_a, a] == faces[face_b, b]
            links_a.append((face_a * 3 + a)[meet])
            links_b.append((face_b * 3 + b)[meet])
    label = _component_labels(3 * face_count, np.concatenate(links_a), np.concatenate(links_b))
    return int((label == np.arange(3 * face_count)).sum())


def topology(faces: npt.ArrayLike) -> Topology:
    """Validity figures of faces (N, 3).

    Raises:
        MeshShapeError: not (N, 3) integers.
        DegenerateMeshError: no face.
        FaceIndexError: a vertex index that is negative, or larger than there can be.

    Examples:
        A closed surface of two tetrahedra that do not touch:

        >>> import warpqem
        >>> one = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)]
        >>> found = warpqem.measure.topology(one + [(a + 4, b + 4, c + 4) for a, b, c in one])
        >>> found.faces, found.components
        (8, 2)
    """
    checked = read_faces(faces, "mesh faces", None).astype(np.int64)
    used, compact = np.unique(checked, return_inverse=True)
    compact = compact.reshape(-1, 3)
    edges, edge_of_half_edge, count = unique_edges(compact)
    label = _component_labels(len(used), edges[:, 0], edges[:, 1])
    ordered = np.sort(compact, axis=1)
    return Topology(
        faces=len(compact),
        vertices=len(used),
        edges=len(edges),
        non_manifold_edges=int((count > 2).sum()),
        non_manifold_vertices=_fan_count(compact, edge_of_half_edge) - len(used),
        border_edges=int((count == 1).sum()),
        components=int((label == np.arange(len(used))).sum()),
        euler_number=len(used) - len(edges) + len(compact),
        repeated_faces=len(compact) - len(np.unique(ordered, axis=0)),
        collapsed_faces=int((ordered[:, 1:] == ordered[:, :-1]).any(axis=1).sum()),
    )
