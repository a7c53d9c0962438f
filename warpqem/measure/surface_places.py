"""Places of an input and of a simplified mesh of it, each with the faces of the other one that may be nearest to it.

Places are vertices of both, points of faces of the simplified mesh, and of those faces of the input that are larger
than its: nothing says that what lies over such a face is near to it, just as its vertices are. Vertices of the
simplified mesh stand for clusters: an input vertex is looked for at the faces of its cluster, and what belongs to the
simplified mesh at the input faces of the clusters there. So a place is never nearest to another part of the mesh.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.kernels import distance_points as kernels
from warpqem.kernels.lanes import width_of
from warpqem.measure.far_points import FacesAround, PointsAndFaces, furthest_from, longest_edges, unique_pairs
from warpqem.runtime.part_launches import corners_of, launch_in_parts, rows_of

__all__ = [
    "InputVertices",
    "Places",
    "SampledFaces",
    "Side",
    "SimplifiedVertices",
    "furthest_of",
    "input_side",
    "large_faces",
]

# Points of a face: its middle and those of its edges.
SAMPLES = np.array([[1, 1, 1], [1.5, 1.5, 0], [0, 1.5, 1.5], [1.5, 0, 1.5]], dtype=np.float32) / 3
# Faces of the input whose longest edge in any frame is so many times the mean of those of the simplified mesh have
# points of their own. With 0.7 times the same spots are found.
LARGE = 1.5
# Faces whose points are looked at at once: some 50 MB of them.
FACES_AT_ONCE = 8192


@dataclass(frozen=True)
class Side:
    """Faces of one surface, and those that may be nearest to a cluster.

    Attributes:
        lanes: (V, B) blocks of its points.
        faces: what its faces' corners are.
        lists: where each cluster starts, (C+1,) int32, and its faces, int32.
    """

    lanes: wp.array
    faces: FacesAround
    lists: tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]


@dataclass(frozen=True)
class _Vertices:
    """Vertices (n,) of one surface, and the other one.

    Attributes:
        lanes: (V, B) blocks of its points.
        side: the other surface.
        vertex: (n,) int.
    """

    lanes: wp.array
    side: Side
    vertex: npt.NDArray[np.integer]
    points_of_each: ClassVar[int] = 1

    @property
    def count(self) -> int:
        """Vertices n."""
        return len(self.vertex)


@dataclass(frozen=True)
class InputVertices(_Vertices):
    """Input vertices (n,), each with its cluster.

    Attributes:
        cluster: (n,) int.
    """

    cluster: npt.NDArray[np.integer]

    @property
    def clusters(self) -> npt.NDArray[np.integer]:
        """(n, 1) int, where each is."""
        return self.cluster[:, None]

    def around(self, chosen: npt.NDArray[np.integer] | None) -> Iterator[PointsAndFaces]:
        """The points and the faces around; with one ring more for those that are ``chosen``, indices (m,)."""
        point, cluster, lists = self.vertex, self.cluster, self.side.lists
        if chosen is not None:
            lists = self.side.faces.second_ring(cluster[chosen])
            point, cluster = point[chosen], np.arange(len(chosen))
        yield PointsAndFaces.at(self.lanes, self.side.lanes, self.side.faces, point, cluster, lists)


@dataclass(frozen=True)
class SampledFaces:
    """Points of faces (m, 3), with the clusters (m, 3) at which a side has what may be nearest.

    Attributes:
        lanes: (V, B) blocks of the points of their surface.
        faces: (m, 3) int, its vertices.
        clusters: (m, 3) int.
        side: the other surface.
        around_clusters: the simplified mesh's faces at each of its clusters.
    """

    lanes: wp.array
    faces: npt.NDArray[np.integer]
    clusters: npt.NDArray[np.integer]
    side: Side
    around_clusters: FacesAround
    points_of_each: ClassVar[int] = len(SAMPLES)

    @property
    def count(self) -> int:
        """Faces m."""
        return len(self.faces)

    def around(self, chosen: npt.NDArray[np.integer] | None) -> Iterator[PointsAndFaces]:
        """The points and the faces around; with one ring more for those that are ``chosen``, indices (m,)."""
        simplified = self.around_clusters.corner_vertex.reshape(-1, 3)
        rows = np.arange(self.count) if chosen is None else chosen
        for first in range(0, len(rows), FACES_AT_ONCE):
            part = rows[first : first + FACES_AT_ONCE]
            cluster = self.clusters[part].ravel()
            start = np.arange(0, len(cluster) + 1, 3)
            if chosen is not None:
                # The nearest face may be at a cluster next to these.
                face, place = self.around_clusters.of(cluster)
                row, cluster = unique_pairs(np.repeat(place // 3, 3), simplified[face].ravel())
                start = np.searchsorted(row, np.arange(len(part) + 1))
            point = np.arange(len(SAMPLES) * len(part))
            points = self._points(self.faces[part])
            clusters, side = (start, cluster), self.side
            yield PointsAndFaces(points, side.lanes, side.faces, point, point // len(SAMPLES), clusters, side.lists)

    def _points(self, faces: npt.NDArray[np.integer]) -> wp.array:
        """Blocks of the points of some faces (m, 3), one face after another."""
        device = str(self.lanes.device)
        blocks = self.lanes.shape[1]
        points = wp.empty((len(faces), len(SAMPLES) * blocks), dtype=self.lanes.dtype, device=device)
        corner_vertex = wp.array(np.ascontiguousarray(faces, dtype=np.int32).ravel(), dtype=wp.int32, device=device)
        weights = wp.array(SAMPLES, dtype=wp.vec3, device=device)
        launch_in_parts(
            kernels.points_of_faces[width_of(self.lanes)],
            (len(faces), len(SAMPLES), blocks),
            [self.lanes, corners_of(corner_vertex), weights],
            [rows_of(points)],
            device=device,
        )
        return points.reshape((-1, blocks))


@dataclass(frozen=True)
class SimplifiedVertices(_Vertices):
    """Vertices (n,) of the simplified mesh, with the faces of the input at their clusters: one that sticks out of the
    input is further away than any point inside its faces.

    Attributes:
        around_clusters: the simplified mesh's faces at each of its clusters.
    """

    around_clusters: FacesAround

    @property
    def clusters(self) -> npt.NDArray[np.integer]:
        """(n, 1) int, where each is."""
        return self.vertex[:, None]

    def around(self, chosen: npt.NDArray[np.integer] | None) -> Iterator[PointsAndFaces]:
        """The points and the faces around; with one ring more for those that are ``chosen``, indices (m,)."""
        side = self.side
        if chosen is None:
            yield PointsAndFaces.at(self.lanes, side.lanes, side.faces, self.vertex, self.vertex, side.lists)
            return
        point, every = self.vertex[chosen], np.arange(len(chosen) + 1)
        face, place = self.around_clusters.of(point)
        simplified = self.around_clusters.corner_vertex.reshape(-1, 3)
        row, cluster = unique_pairs(np.repeat(place, 3), simplified[face].ravel())
        clusters = np.searchsorted(row, every), cluster
        yield PointsAndFaces(self.lanes, side.lanes, side.faces, point, every[:-1], clusters, side.lists)


Places = InputVertices | SampledFaces | SimplifiedVertices


def input_side(
    lanes: wp.array, around: FacesAround, cluster: npt.NDArray[np.integer], faces: npt.NDArray[np.integer], count: int
) -> Side:
    """The input, with its faces at the members of each cluster.

    Args:
        lanes: (V, B) blocks of its points.
        around: its faces.
        cluster: (V,) int.
        faces: (n,) int, which of its faces are looked for.
        count: clusters.
    """
    corners = cluster[around.corner_vertex.reshape(-1, 3)[faces]]
    at_clusters = FacesAround(corners, count)
    return Side(lanes, around, (at_clusters.start, faces[at_clusters.face].astype(np.int32)))


def large_faces(
    reference: wp.array, around: FacesAround, test: wp.array, faces: npt.NDArray[np.integer], device: str
) -> npt.NDArray[np.int64]:
    """The input's faces, of blocks ``reference``, that are larger than those of a simplified mesh, ``test``."""
    own, simplified = longest_edges([(reference, around.corner_vertex.reshape(-1, 3)), (test, faces)], device)
    return np.flatnonzero(own > LARGE * float(simplified.mean()))


def furthest_of(
    places: Sequence[Places], limits: Sequence[npt.NDArray[np.floating]], device: str
) -> list[npt.NDArray[np.float32]]:
    """How far each place is, in the frames of the blocks, from the nearest of its faces.

    The device is waited for twice, whatever is looked at.

    Args:
        places: what to look at.
        limits: (n,) of each; what is within it is looked at no closer, and has any distance that is.
        device: Warp device.

    Returns:
        (n,) of each.
    """
    found = _found(places, limits, [None] * len(places), device)
    far = [np.flatnonzero(distance > limit) for distance, limit in zip(found, limits, strict=True)]
    # The nearest face may be one further on.
    within = [limit[index] for limit, index in zip(limits, far, strict=True)]
    for distance, index, again in zip(found, far, _found(places, within, far, device), strict=True):
        distance[index] = again
    return found


def _found(
    places: Sequence[Places],
    limits: Sequence[npt.NDArray[np.floating]],
    chosen: Sequence[npt.NDArray[np.integer] | None],
    device: str,
) -> list[npt.NDArray[np.float32]]:
    """The distances of those that are chosen, None for all, with the limits of these, from the faces around them."""
    counts = [len(limit) for limit in limits]
    each = [one.points_of_each for one in places]
    given = (
        around
        for one, index, count in zip(places, chosen, counts, strict=True)
        if count
        for around in one.around(index)
    )
    within = np.concatenate([np.repeat(limit, number) for limit, number in zip(limits, each, strict=True)])
    ends = np.cumsum(np.multiply(counts, each))
    found = np.split(furthest_from(given, within, device), ends[:-1])
    return [part.reshape(-1, number).max(axis=1) for part, number in zip(found, each, strict=True)]
