"""The reference and the vertices of a test mesh on a few key frames, for binding one to the other."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.kernels.binding import find_facing, walk_surface
from warpqem.measure.checked_meshes import CheckedMesh
from warpqem.measure.coincidence import coincident
from warpqem.measure.sampling import normals_and_areas, place
from warpqem.measure.validity import unique_edges
from warpqem.mesh.edges import edge_key
from warpqem.place.cluster_rows import group_rows
from warpqem.runtime import new_arrays
from warpqem.runtime.launches import launch

__all__ = [
    "WALK_STEPS",
    "ReferenceSurface",
    "Rings",
    "TestVertices",
    "facing_sign",
    "make_rings",
    "nearest_facing",
    "walk",
]

# Steps of a walk at most. From a neighbour's point to a vertex it crosses the reference faces under one test edge.
WALK_STEPS = 256

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
# For each corner the first and last entry of the corners around its vertex, and those corners: int32 on a device.
Rings = tuple[wp.array, wp.array, wp.array]


def nearest_facing(
    points: Floats,
    corner_vertex: wp.array,
    query: Floats,
    normal: Floats,
    distance: Floats,
    reach: Floats,
    device: str,
    labels: tuple[Ints, Ints] | None = None,
    mesh: wp.Mesh | None = None,
) -> Ints:
    """The nearest face to each query that faces as its normal does, (S,) int64; -1 where none is in reach.

    Args:
        points: (V, 3) of about unit size around the origin.
        corner_vertex: (3N,) int32 on the device.
        query: (S, 3).
        normal: (S, 3) of any length; of length 0 for a query that any face will do for.
        distance: (S,) of the query from the nearest face whichever way it faces.
        reach: (S,) the largest distance looked at.
        device: Warp device.
        labels: (N,) and (S,), labels of the faces, and the label that a query wants, -1 for any; None for any.
        mesh: the hierarchy of these points, where there is one.
    """
    face_label, label = labels or (np.zeros(1, dtype=np.int64), np.full(len(query), -1))
    if mesh is None:
        mesh = wp.Mesh(points=new_arrays.uploaded(points, dtype=wp.vec3, device=device), indices=corner_vertex)
    face = new_arrays.empty(len(query), dtype=wp.int32, device=device)
    doubles = [new_arrays.uploaded(values, dtype=wp.vec3d, device=device) for values in (points, query, normal)]
    launch(
        find_facing,
        dim=len(query),
        inputs=[
            mesh.id,
            doubles[0],
            corner_vertex,
            *doubles[1:],
            *(new_arrays.uploaded(values, dtype=wp.int32, device=device) for values in (face_label, label)),
            *(new_arrays.uploaded(values, dtype=wp.float64, device=device) for values in (distance, reach)),
        ],
        outputs=[face],
        device=device,
    )
    return face.numpy().astype(np.int64)


def facing_sign(along: Floats, distance: Floats) -> float:
    """-1 where one mesh is the other turned inside out, else 1, by points of one and the nearest faces of the other.

    Points count less the further away they are: those may be nearest to the other side of a thin part.

    Args:
        along: (S,) positive where the two face the same way, negative where against each other.
        distance: (S,) of the points from the faces.
    """
    if not distance.any():
        return 1.0 if (along > 0).sum() >= (along < 0).sum() else -1.0
    vote = np.sign(along) / (distance + distance.mean())
    return 1.0 if vote.sum() >= 0 else -1.0


def walk(
    points: wp.array,
    corner_vertex: wp.array,
    rings: Rings,
    start: npt.NDArray[np.integer],
    query: Floats,
    steps: int,
) -> tuple[Ints, Floats]:
    """Faces (S,) and barycentric coordinates (S, 3) downhill from start faces (S,) to queries (S, 3)."""
    device = corner_vertex.device
    face = new_arrays.empty(len(query), dtype=wp.int32, device=device)
    barycentric = new_arrays.zeros(len(query), dtype=wp.vec3d, device=device)
    launch(
        walk_surface,
        dim=len(query),
        inputs=[
            points,
            corner_vertex,
            *rings,
            new_arrays.uploaded(start, dtype=wp.int32, device=device),
            new_arrays.uploaded(query, dtype=wp.vec3d, device=device),
            steps,
        ],
        outputs=[face, barycentric],
        device=device,
    )
    return face.numpy().astype(np.int64), barycentric.numpy()


def make_rings(corner_place: Ints, device: str) -> Rings:
    """The corners (3N,) around each corner's place, which is the number of a place from 0 on."""
    order, start = group_rows(corner_place, int(corner_place.max(initial=0)) + 1)
    arrays = (start[corner_place], start[corner_place + 1], order)
    first, last, corner = (new_arrays.uploaded(values, dtype=wp.int32, device=device) for values in arrays)
    return first, last, corner


class ReferenceSurface:
    """The reference on the key frames, scaled, with what is next to each face."""

    def __init__(self, mesh: CheckedMesh, centre: Floats, diagonal: Floats, frames: list[int], device: str) -> None:
        self.mesh, self.frames, self.device = mesh, frames, device
        self.centre, self.diagonal = centre[frames], diagonal[frames]
        self.points = self.scaled(mesh)
        self.corner_vertex = wp.array(mesh.faces.ravel(), dtype=wp.int32, device=device)
        self._exact = wp.array(self.points[0], dtype=wp.vec3d, device=device)
        # Faces of their own vertices meet where those are at the same place in all key frames.
        place_of = coincident(self.points)
        self._rings = make_rings(place_of[mesh.faces.ravel()], device)
        self._place_of = place_of
        tail = place_of[mesh.faces]
        self._edges = np.unique(edge_key(tail, np.roll(tail, -1, axis=1), len(place_of)))

    def scaled(self, mesh: CheckedMesh) -> Floats:
        """A mesh's points in the key frames (K, V, 3), about the origin with the reference's diagonal as unit."""
        return np.stack(
            [(mesh.points[f] - c) / d for f, c, d in zip(self.frames, self.centre, self.diagonal, strict=True)]
        )

    def walk(self, start: npt.NDArray[np.integer], query: Floats, steps: int = WALK_STEPS) -> tuple[Ints, Floats]:
        """Faces (S,) and barycentric coordinates (S, 3) downhill from start faces to queries, in the first frame."""
        return walk(self._exact, self.corner_vertex, self._rings, start, query, steps)

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
        key = edge_key(a, b, len(self._place_of))
        at = np.searchsorted(self._edges, key).clip(0, len(self._edges) - 1)
        joined: npt.NDArray[np.bool_] = ((a == b) | (self._edges[at] == key)).any(axis=1)
        return joined

    def facing(
        self, key: int, query: Floats, normal: Floats, distance: Floats, reach: Floats, mesh: wp.Mesh | None
    ) -> Ints:
        """The nearest face to each query (S, 3) in a key frame that faces as its normal does; -1: none in reach.

        ``mesh`` is the hierarchy of that frame, where there is one.
        """
        points = self.points[key]
        return nearest_facing(points, self.corner_vertex, query, normal, distance, reach, self.device, mesh=mesh)


class TestVertices:
    """The test vertices in use on the key frames, and how they hang together.

    Attributes:
        points: (K, U, 3) scaled.
        normals: (K, U, 3) sums of the normals of the faces around each, as long as twice their area.
        edges: (2E, 2) ends of the edges, both ways; vertices at the same place in all key frames are joined, too.
        reach: (U,) the longest edge at each vertex in the first frame.
    """

    def __init__(self, test: CheckedMesh, surface: ReferenceSurface) -> None:
        self.points = surface.scaled(test)[:, test.used]
        faces = np.searchsorted(test.used, test.faces)
        place_of = coincident(self.points)
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


def _vertex_normals(points: Floats, faces: Ints, count: int) -> Floats:
    """Sums over the faces around each vertex (count, 3)."""
    unit, area = normals_and_areas(points, faces)
    weighted = np.repeat(unit * area[:, None], 3, axis=0)
    return np.stack([np.bincount(faces.ravel(), weighted[:, k], count) for k in range(3)], axis=1)
