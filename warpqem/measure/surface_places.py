"""Places of an input and of a simplified mesh of it, each with the faces of the other one that may be nearest to it.

Places are vertices of both, points of faces of the simplified mesh, and of those faces of the input that are larger
than its: nothing says that what lies over such a face is near to it, just as its vertices are. Vertices of the
simplified mesh stand for clusters: an input vertex is looked for at the faces of its cluster, and what belongs to the
simplified mesh at the input faces of the clusters there. So a place is never nearest to another part of the mesh.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.kernels import distance_points as kernels
from warpqem.kernels.lanes import width_of
from warpqem.kernels.large_faces import largest_of_points
from warpqem.measure.face_lists import FaceLists, FacesAround, faces_at_clusters
from warpqem.measure.far_points import PointLists, PointsAndFaces, furthest_from
from warpqem.measure.large_faces import LargeFaces
from warpqem.runtime import new_arrays
from warpqem.runtime.device import device_traits
from warpqem.runtime.launches import launch
from warpqem.runtime.part_launches import corners_of, launch_in_parts, rows_of
from warpqem.runtime.readback import read_together

__all__ = [
    "InputVertices",
    "Places",
    "SampledFaces",
    "Side",
    "SimplifiedVertices",
    "furthest_of",
    "furthest_with_large",
    "input_side",
    "squared_distances",
]

# Points of a face: its middle and those of its edges.
SAMPLES = np.array([[1, 1, 1], [1.5, 1.5, 0], [0, 1.5, 1.5], [1.5, 0, 1.5]], dtype=np.float32) / 3
# Points of faces that are looked at at once: some 50 MB of them.
POINTS_AT_ONCE = 32768


@dataclass(frozen=True)
class Side:
    """Faces of one surface, and those that may be nearest to a cluster.

    Attributes:
        lanes: (V, B) blocks of its points.
        faces: what its faces' corners are.
        lists: its faces at each cluster.
    """

    lanes: wp.array
    faces: FacesAround
    lists: FaceLists


@dataclass(frozen=True)
class _Vertices(ABC):
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

    @property
    @abstractmethod
    def clusters(self) -> npt.NDArray[np.integer]:
        """(n, 1) int, where each is."""

    @property
    def lists(self) -> PointLists:
        """The vertices with their clusters; those of a small mesh are kept for all looks at them."""
        return self._kept_lists if self.count <= POINTS_AT_ONCE else PointLists.at(self.vertex, self.clusters[:, 0])

    @cached_property
    def _kept_lists(self) -> PointLists:
        return PointLists.at(self.vertex, self.clusters[:, 0])


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

    def around(self, _: wp.array) -> Iterator[PointsAndFaces]:
        """The points and the faces around."""
        side = self.side
        yield PointsAndFaces(self.lanes, side.lanes, side.faces, self.lists, side.lists, side.faces)


@dataclass(frozen=True)
class SampledFaces:
    """Points of faces (m, 3), with the clusters (m, c) at which a side has what may be nearest.

    Attributes:
        lanes: (V, B) blocks of the points of their surface.
        faces: (m, 3) int, its vertices, on the host or the device.
        clusters: (m, c) int, likewise.
        side: the other surface.
        around_clusters: the simplified mesh's faces at each of its clusters.
        weights: (s, 3) float32, of the corners, for each point of a face.
    """

    lanes: wp.array
    faces: npt.NDArray[np.integer] | wp.array
    clusters: npt.NDArray[np.integer] | wp.array
    side: Side
    around_clusters: FacesAround
    weights: npt.NDArray[np.floating] = field(default_factory=lambda: SAMPLES)

    @property
    def points_of_each(self) -> int:
        """Points of a face."""
        return len(self.weights)

    @property
    def count(self) -> int:
        """Faces m."""
        return len(self.faces)

    def around(self, within: wp.array) -> Iterator[PointsAndFaces]:
        """The points and the faces around; points of negative ``within`` (m s,) are not made."""
        side, around, each = self.side, self.around_clusters, self.points_of_each
        at_once = max(1, POINTS_AT_ONCE // each)
        for first in range(0, self.count, at_once):
            last = min(first + at_once, self.count)
            whole = last - first == self.count
            corners, lists = self._all_lists if whole else self._lists(slice(first, last))
            points = self._points(corners, new_arrays.part(within, each * first, each * last))
            yield PointsAndFaces(points, side.lanes, side.faces, lists, side.lists, around)

    @cached_property
    def _all_lists(self) -> tuple[wp.array, PointLists]:
        """Those of all faces, for all looks at them."""
        return self._lists(slice(self.count))

    def _lists(self, some: slice) -> tuple[wp.array, PointLists]:
        """The corners (3 m,) of some faces on the device, and their points with their clusters."""
        faces, clusters, each = self.faces[some], self.clusters[some], self.points_of_each
        if not isinstance(faces, wp.array):
            faces = new_arrays.uploaded(faces, dtype=wp.int32, device=str(self.lanes.device))
        start = np.arange(0, clusters.size + 1, clusters.shape[1], dtype=np.int32)
        point = np.arange(each * len(faces), dtype=np.int32)
        return faces.reshape(-1), PointLists(point, np.repeat(point[: len(faces)], each), (start, clusters.reshape(-1)))

    def _points(self, corner_vertex: wp.array, within: wp.array) -> wp.array:
        """Blocks of the points of some faces, of these corners (3 m,), one face after another."""
        device, each = str(self.lanes.device), self.points_of_each
        count, blocks = len(corner_vertex) // 3, self.lanes.shape[1]
        points = new_arrays.empty((count, each * blocks), dtype=self.lanes.dtype, device=device)
        weights = new_arrays.uploaded(self.weights, dtype=wp.vec3, device=device)
        launch_in_parts(
            kernels.points_of_faces[width_of(self.lanes)],
            (count, each, blocks),
            [self.lanes, corners_of(corner_vertex), weights, rows_of(new_arrays.shaped(within, (count, each)))],
            [rows_of(points)],
            device=device,
        )
        return new_arrays.shaped(points, (each * count, blocks))


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

    def around(self, _: wp.array) -> Iterator[PointsAndFaces]:
        """The points and the faces around."""
        side = self.side
        yield PointsAndFaces(self.lanes, side.lanes, side.faces, self.lists, side.lists, self.around_clusters)


Places = InputVertices | SampledFaces | SimplifiedVertices


def input_side(
    lanes: wp.array,
    around: FacesAround,
    cluster: npt.NDArray[np.integer] | wp.array,
    count: int,
    faces: npt.NDArray[np.integer] | None = None,
) -> Side:
    """The input, with its faces at the members of each cluster.

    Args:
        lanes: (V, B) blocks of its points.
        around: its faces.
        cluster: (V,) int32, on the host, or where the lists are made there, on the device.
        count: clusters.
        faces: (n,) int, those that are asked for at least; None for all.
    """
    return Side(lanes, around, faces_at_clusters(around, cluster, count, faces, str(lanes.device)))


def furthest_of(
    places: Sequence[Places], limits: Sequence[npt.NDArray[np.floating]], device: str
) -> list[npt.NDArray[np.float32]]:
    """How far each place is, in the frames of the blocks, from the nearest of its faces.

    They come to the host at once.

    Args:
        places: what to look at.
        limits: (n,) of each; what is within it is looked at no closer, and has any distance that is.
        device: Warp device.

    Returns:
        (n,) of each.
    """
    each = [one.points_of_each for one in places]
    limit = np.concatenate([np.repeat(limit, number) for limit, number in zip(limits, each, strict=True)])
    if not len(limit):
        return [np.empty(0, dtype=np.float32) for _ in places]
    within = wp.array(np.square(limit, dtype=np.float32), dtype=wp.float32, device=device)
    return _brought(squared_distances(places, within, device), places)[0]


def furthest_with_large(
    places: Sequence[Places], large: SampledFaces, listed: LargeFaces, limit: float, device: str
) -> tuple[list[npt.NDArray[np.float32]], npt.NDArray[np.int32]]:
    """How far each place is, and points of the large faces that the device has ``listed``, last of all.

    The list, ``LargeFaces.rows``, comes to the host along with them; rows without a face are 0.
    """
    together = [*places, large]
    count = sum(one.count * one.points_of_each for one in together)
    within = new_arrays.full(count, float(np.square(limit, dtype=np.float32)), dtype=wp.float32, device=device)
    listed.leave_out_others(within[count - large.count * large.points_of_each :], large.points_of_each)
    found, (rows,) = _brought(squared_distances(together, within, device), together, listed.rows)
    return found, rows


def _brought(
    squared: wp.array, places: Sequence[Places], *others: wp.array
) -> tuple[list[npt.NDArray[np.float32]], list[np.ndarray]]:
    """The largest distance of the points of each place, (n,) of each of ``places``, of squared ones; and other arrays.

    What takes a wait comes to the host at once, and no more of it than that.
    """
    each = [one.points_of_each for one in places]
    ends = np.cumsum([one.count * number for one, number in zip(places, each, strict=True)])
    if not device_traits(str(squared.device)).own_memory:
        found = np.split(np.sqrt(squared.numpy()), ends[:-1])
        largest = [part.reshape(-1, number).max(axis=1) for part, number in zip(found, each, strict=True)]
        return largest, [other.numpy() for other in others]
    there = []
    for one, end in zip(places, ends.tolist(), strict=True):
        of_points = squared[end - one.count * one.points_of_each : end] if one.count else squared[:0]
        of_places = new_arrays.empty(one.count, dtype=wp.float32, device=squared.device)
        inputs = [of_points, one.points_of_each]
        launch(largest_of_points, one.count, inputs, [of_places], device=squared.device)
        there.append(of_places)
    brought = read_together(*there, *others)
    return [np.sqrt(part) for part in brought[: len(places)]], brought[len(places) :]


def squared_distances(
    places: Sequence[Places], within: wp.array, device: str, nearest: wp.array | None = None
) -> wp.array:
    """The same squared, (m,) float32 on the device, of all points of all places, one after another.

    Args:
        places: what to look at.
        within: (m,) float32 on the device, the limits of the points, squared; those of a negative one are left out.
        device: Warp device.
        nearest: (m,) int32, see :func:`warpqem.measure.far_points.furthest_from`.
    """
    return furthest_from(_points_around(places, within), within, device, nearest)


def _points_around(places: Sequence[Places], within: wp.array) -> Iterator[PointsAndFaces]:
    """The points of all places, one after another, with their limits (m,), squared."""
    first = 0
    for one in places:
        last = first + one.count * one.points_of_each
        if last > first:
            yield from one.around(new_arrays.part(within, first, last))
        first = last
