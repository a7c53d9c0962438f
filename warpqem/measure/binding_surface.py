"""The reference and the vertices of a test mesh on a few key frames, for binding one to the other."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.edges import edge_key
from warpqem.kernels.binding import find_facing, walk_surface
from warpqem.launches import launch
from warpqem.measure.inputs import MeshSequence
from warpqem.measure.sampling import normals_and_areas, place
from warpqem.measure.topology import unique_edges
from warpqem.place.rows import group_rows

__all__ = ["WALK_STEPS", "ReferenceSurface", "TestVertices"]

# Steps of a walk at most. From a neighbour's point to a vertex it crosses the reference faces under one test edge.
WALK_STEPS = 256

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


class ReferenceSurface:
    """The reference on the key frames, scaled, with what is next to each face."""

    def __init__(self, mesh: MeshSequence, centre: Floats, diagonal: Floats, frames: list[int], device: str) -> None:
        self.mesh, self.frames, self.device = mesh, frames, device
        self.centre, self.diagonal = centre[frames], diagonal[frames]
        self.points = self.scaled(mesh)
        self.corner_vertex = wp.array(mesh.faces.ravel(), dtype=wp.int32, device=device)
        self._exact = wp.array(self.points[0], dtype=wp.vec3d, device=device)
        # Faces of their own vertices meet where those are at the same place in all key frames.
        place_of = _coincident(self.points)
        order, start = group_rows(place_of[mesh.faces.ravel()], len(place_of))
        self._place_of = place_of
        tail = place_of[mesh.faces]
        self._edges = np.unique(edge_key(tail, np.roll(tail, -1, axis=1), len(place_of)))
        self._ring_start = wp.array(start[place_of], dtype=wp.int32, device=device)
        self._ring_end = wp.array(start[place_of + 1], dtype=wp.int32, device=device)
        self._ring_corner = wp.array(order, dtype=wp.int32, device=device)

    def scaled(self, mesh: MeshSequence) -> Floats:
        """A mesh's points in the key frames (K, V, 3), about the origin with the reference's diagonal as unit."""
        return np.stack(
            [(mesh.points[f] - c) / d for f, c, d in zip(self.frames, self.centre, self.diagonal, strict=True)]
        )

    def walk(self, start: npt.NDArray[np.integer], query: Floats, steps: int = WALK_STEPS) -> tuple[Ints, Floats]:
        """Faces (S,) and barycentric coordinates (S, 3) downhill from start faces to queries, in the first frame."""
        face = wp.empty(len(query), dtype=wp.int32, device=self.device)
        barycentric = wp.zeros(len(query), dtype=wp.vec3d, device=self.device)
        launch(
            walk_surface,
            dim=len(query),
            inputs=[
                self._exact,
                self.corner_vertex,
                self._ring_start,
                self._ring_end,
                self._ring_corner,
                wp.array(start, dtype=wp.int32, device=self.device),
                wp.array(query, dtype=wp.vec3d, device=self.device),
                steps,
            ],
            outputs=[face, barycentric],
            device=self.device,
        )
        return face.numpy().astype(np.int64), barycentric.numpy()

    def place(self, face: Ints, barycentric: Floats) -> Floats:
        """Material points (S,) in the key frames, (K, S, 3)."""
        return np.stack([place(points, self.mesh.faces, face, barycentric) for points in self.points])

    def mean_square(self, points: Floats, face: Ints, barycentric: Floats) -> Floats:
        """Mean square distance (S,) over the key frames of points (K, S, 3) from material points."""
        squared: Floats = ((self.place(face, barycentric) - points) ** 2).sum(axis=2).mean(axis=0)
        return squared

    def adjoin(self, one: Ints, other: Ints) -> npt.NDArray[np.bool_]:
        """(S,) where two faces share a vertex, or an edge leads from one to the other."""
        a, b = (np.repeat(self._place_of[self.mesh.faces[face]], 3, axis=1) for face in (one, other))
        b = b[:, [0, 3, 6, 1, 4, 7, 2, 5, 8]]
        joined: npt.NDArray[np.bool_] = ((a == b) | np.isin(edge_key(a, b, len(self._place_of)), self._edges)).any(
            axis=1
        )
        return joined

    def facing(self, key: int, query: Floats, normal: Floats, distance: Floats, reach: Floats) -> Ints:
        """The nearest face to each query (S, 3) in a key frame that faces as its normal does; -1: none in reach."""
        points = self.points[key]
        mesh = wp.Mesh(
            points=wp.array(points, dtype=wp.vec3, device=self.device),
            indices=self.corner_vertex,
        )
        face = wp.empty(len(query), dtype=wp.int32, device=self.device)
        launch(
            find_facing,
            dim=len(query),
            inputs=[
                mesh.id,
                wp.array(points, dtype=wp.vec3d, device=self.device),
                self.corner_vertex,
                wp.array(query, dtype=wp.vec3d, device=self.device),
                wp.array(normal, dtype=wp.vec3d, device=self.device),
                wp.array(distance, dtype=wp.float64, device=self.device),
                wp.array(reach, dtype=wp.float64, device=self.device),
            ],
            outputs=[face],
            device=self.device,
        )
        return face.numpy().astype(np.int64)


class TestVertices:
    """The test vertices in use on the key frames, and how they hang together.

    Attributes:
        points: (K, U, 3) scaled.
        normals: (K, U, 3) sums of the normals of the faces around each, as long as twice their area.
        edges: (2E, 2) ends of the edges, both ways; vertices at the same place in all key frames are joined, too.
        reach: (U,) the longest edge at each vertex in the first frame.
    """

    def __init__(self, test: MeshSequence, surface: ReferenceSurface) -> None:
        self.points = surface.scaled(test)[:, test.used]
        faces = np.searchsorted(test.used, test.faces)
        place_of = _coincident(self.points)
        self.normals = np.stack([_vertex_normals(points, place_of[faces], len(place_of)) for points in self.points])
        self.normals = self.normals[:, place_of]
        one_way = np.sort(unique_edges(faces)[0], axis=1)
        twins = np.flatnonzero(place_of != np.arange(len(place_of)))
        one_way = np.concatenate([one_way, np.stack([place_of[twins], twins], axis=1)])
        self.edges = np.concatenate([one_way, one_way[:, ::-1]])
        self.length = np.linalg.norm(self.points[0][self.edges[:, 0]] - self.points[0][self.edges[:, 1]], axis=1)
        self.reach = np.zeros(len(test.used))
        np.maximum.at(self.reach, self.edges[:, 0], self.length)

    def __len__(self) -> int:
        return len(self.reach)


def _coincident(points: Floats) -> Ints:
    """(V,) the first vertex at the place of each in all frames of (K, V, 3)."""
    rows = points.transpose(1, 0, 2).reshape(points.shape[1], -1)
    order = np.lexsort(rows.T)
    new = np.ones(len(rows), dtype=bool)
    new[1:] = (rows[order[1:]] != rows[order[:-1]]).any(axis=1)
    first = np.minimum.reduceat(order, np.flatnonzero(new)) if len(rows) else order
    label = np.empty(len(rows), dtype=np.int64)
    label[order] = first[np.cumsum(new) - 1]
    return label


def _vertex_normals(points: Floats, faces: Ints, count: int) -> Floats:
    """Sums over the faces around each vertex (count, 3)."""
    unit, area = normals_and_areas(points, faces)
    weighted = np.repeat(unit * area[:, None], 3, axis=0)
    return np.stack([np.bincount(faces.ravel(), weighted[:, k], count) for k in range(3)], axis=1)
