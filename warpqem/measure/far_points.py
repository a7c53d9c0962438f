"""Points of a mesh that are far from another one in some frame, as faces around show: found fast, and not proved."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.kernels import distance_points as kernels
from warpqem.kernels.lanes import width_of
from warpqem.measure.face_lists import FaceLists, FacesAround, uploaded
from warpqem.runtime import new_arrays
from warpqem.runtime.device import device_traits
from warpqem.runtime.part_launches import corners_of, launch_in_parts, rows_of
from warpqem.runtime.readback import read_together

__all__ = [
    "PointLists",
    "PointsAndFaces",
    "furthest_from",
    "longest_edges",
    "longest_edges_there",
]

# Points, or faces, that are worth a thread: some hundred nanoseconds each.
MIN_POINTS = 1024


class PointLists:
    """Points and the clusters of each, on the device that they are first asked for.

    Args:
        point: (n,) int, points.
        row: (n,) int, the row of ``clusters`` for each.
        clusters: where each row starts, (R+1,) int, and clusters, int, on the host or the device.
    """

    def __init__(
        self,
        point: npt.NDArray[np.integer],
        row: npt.NDArray[np.integer],
        clusters: tuple[npt.NDArray[np.integer], npt.NDArray[np.integer] | wp.array],
    ) -> None:
        self._values = (point, row, *clusters)
        self._there: tuple[wp.array, ...] = ()

    def __len__(self) -> int:
        return len(self._values[0])

    def on(self, device: str) -> tuple[wp.array, ...]:
        """All four on the device."""
        if not self._there:
            self._there = tuple(uploaded(values, device) for values in self._values)
        return self._there

    @classmethod
    def at(cls, point: npt.NDArray[np.integer], cluster: npt.NDArray[np.integer]) -> PointLists:
        """Points with one cluster (n,) each."""
        every = np.arange(len(point) + 1)
        return cls(point, every[:-1], (every, cluster))


@dataclass(frozen=True)
class PointsAndFaces:
    """Points, and the faces that may be nearest to each: at its clusters, and at those next to them.

    Attributes:
        own: (P, B) blocks of points.
        other: (V, B) blocks of the same frames of the other mesh.
        faces: its faces.
        points: those of ``own`` to look at, with their clusters.
        lists: faces of ``other`` at each cluster.
        around: the simplified mesh's faces at each cluster.
    """

    own: wp.array
    other: wp.array
    faces: FacesAround
    points: PointLists
    lists: FaceLists
    around: FacesAround


def furthest_from(
    given: Iterable[PointsAndFaces], within: wp.array, device: str, nearest: wp.array | None = None
) -> wp.array:
    """How far points are at most, over the frames, from the nearest of some faces, on the device.

    Args:
        given: points and faces, one after another; each may go when the next one comes.
        within: (n,) float32 on the device, squared, of all points: within its own in all frames of a block, a point is
            looked at no closer.
        device: Warp device.
        nearest: (n,) int32 on the device, a face of each point's to begin with, -1 for none, and then the one where it
            ended: for those who look at the same points again after a small move.

    Returns:
        (n,) float32, squared; of points within the limit anything that is.
    """
    furthest = new_arrays.zeros(len(within), dtype=wp.float32, device=device)
    if nearest is None:
        nearest = new_arrays.full(len(within), -1, dtype=wp.int32, device=device)
    first = 0
    for one in given:
        last = first + len(one.points)
        if last > first:
            rows = [new_arrays.part(array, first, last) for array in (within, nearest, furthest)]
            _measure(one, rows[0], rows[1], rows[2], device)
        first = last
    return furthest


def _measure(given: PointsAndFaces, within: wp.array, nearest: wp.array, furthest: wp.array, device: str) -> None:
    """Raise the squared distances ``furthest`` (n,), zero before, to those found."""
    own, other, count = given.own, given.other, len(given.points)
    point, row, cluster_start, cluster = given.points.on(device)
    inputs = [own, other, given.faces.corners(device), rows_of(point), rows_of(row), cluster_start, cluster]
    # Where points are too few for the device, frames are shared out, too.
    shares = max(1, min(own.shape[1], device_traits(device).launch_threads // count))
    launch_in_parts(
        kernels.distances_of_points[width_of(own)],
        (count, shares),
        [*inputs, *given.lists.on(device), given.around.around(device), rows_of(within), shares],
        [rows_of(nearest), rows_of(furthest)],
        device=device,
        min_items=MIN_POINTS,
    )


def longest_edges(
    surfaces: Sequence[tuple[wp.array, npt.NDArray[np.integer]]], device: str
) -> list[npt.NDArray[np.float32]]:
    """The length of the longest edge of each face (N, 3) in any frame of blocks (V, B), (N,) of each surface.

    They come to the host at once.
    """
    squared = longest_edges_there(surfaces, device)
    return [np.sqrt(brought) for brought in read_together(*squared)]


def longest_edges_there(surfaces: Sequence[tuple[wp.array, npt.NDArray[np.integer]]], device: str) -> list[wp.array]:
    """The same squared, on the device."""
    found = []
    for lanes, faces in surfaces:
        squared = new_arrays.empty(len(faces), dtype=wp.float32, device=device)
        corner_vertex = new_arrays.uploaded(
            np.ascontiguousarray(faces, dtype=np.int32).ravel(), dtype=wp.int32, device=device
        )
        launch_in_parts(
            kernels.longest_edges[width_of(lanes)],
            len(faces),
            [lanes, corners_of(corner_vertex)],
            [rows_of(squared)],
            device=device,
            min_items=MIN_POINTS,
        )
        found.append(squared)
    return found
