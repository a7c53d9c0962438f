"""Faces at vertices and clusters, in lists: made on the host, or where a device has memory of its own, on that."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.kernels import distance_points, face_lists
from warpqem.mesh.grouping import any_corner, order_by
from warpqem.runtime import new_arrays
from warpqem.runtime.ahead import done_ahead
from warpqem.runtime.device import device_traits
from warpqem.runtime.launches import launch

__all__ = ["FaceLists", "FacesAround", "faces_at_clusters", "uploaded"]

# One of so many vertices, or more, are looked for at the corners of all faces, which needs no lists.
MANY = 4
# Vertices whose faces are looked up at once: new memory for all of them takes longer than the rest.
AT_ONCE = 4096


class FaceLists:
    """Faces in lists, as compressed rows; on the device that they are first asked for.

    Args:
        start: (C+1,) int32, where each list starts.
        face: int32, one list after another.
    """

    def __init__(self, start: npt.NDArray[np.int32] | wp.array, face: npt.NDArray[np.int32] | wp.array) -> None:
        self._lists = start, face
        self._there: tuple[wp.array, wp.array] | None = None

    def on(self, device: str) -> tuple[wp.array, wp.array]:
        """Both on the device."""
        if self._there is None:
            self._there = self._made_on(device)
        return self._there

    def _made_on(self, device: str) -> tuple[wp.array, wp.array]:
        start, face = self._lists
        return uploaded(start, device), uploaded(face, device)


class FacesAround(FaceLists):
    """The faces at each vertex of a mesh; lists are made where they are asked for.

    Args:
        faces: (N, 3) int.
        vertex_count: vertices V.
    """

    def __init__(self, faces: npt.NDArray[np.integer], vertex_count: int) -> None:
        self.corner_vertex = np.ascontiguousarray(faces, dtype=np.int32).ravel()
        self._vertex_count = vertex_count
        self._there, self._corners = None, None
        self._ahead: Callable[[], None] | None = None

    def make_ahead(self) -> None:
        """Make the lists of the host in a thread meanwhile, for those who know that they will ask for them."""
        self._ahead = done_ahead(self._make)

    def _make(self) -> None:
        _ = self._start, self._face

    def _wait(self) -> None:
        # Several threads may ask.
        ahead = self._ahead
        if ahead is not None:
            ahead()
            self._ahead = None

    @property
    def start(self) -> npt.NDArray[np.int32]:
        """(V+1,) int32, where the list of each vertex starts."""
        self._wait()
        return self._start

    @property
    def face(self) -> npt.NDArray[np.int32]:
        """(3N,) int32, the faces of one vertex after another."""
        self._wait()
        return self._face

    @functools.cached_property
    def _start(self) -> npt.NDArray[np.int32]:
        start = np.zeros(self._vertex_count + 1, dtype=np.int32)
        np.cumsum(np.bincount(self.corner_vertex, minlength=self._vertex_count), out=start[1:])
        return start

    @functools.cached_property
    def _face(self) -> npt.NDArray[np.int32]:
        return (order_by(self.corner_vertex, self._vertex_count) // 3).astype(np.int32)

    def corners(self, device: str) -> wp.array:
        """(3N,) int32 on the device that it is first asked for, the vertex of each corner."""
        if self._corners is None:
            self._corners = uploaded(self.corner_vertex, device)
        return self._corners

    def around(self, device: str) -> distance_points.Around:
        """What kernels see of it."""
        around = distance_points.Around()
        around.start, around.face = self.on(device)
        around.vertex = self.corners(device)
        return around

    def of(self, vertex: npt.NDArray[np.integer]) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int64]]:
        """The faces at some vertices, and of which of them (n,) each is, one after another."""
        found, count = self._one_after_another(vertex)
        return found, np.repeat(np.arange(len(vertex)), count)

    def repeated(self, vertex: npt.NDArray[np.integer]) -> npt.NDArray[np.int32]:
        """The faces at some vertices, one after another, as often as they have one of these."""
        return self._one_after_another(vertex)[0]

    def at(self, is_there: npt.NDArray[np.bool_]) -> npt.NDArray[np.int64]:
        """The faces that have one of some vertices, (V,) bool, at least; ascending."""
        vertex = np.flatnonzero(is_there)
        if MANY * len(vertex) > self._vertex_count:
            return np.flatnonzero(any_corner(is_there[self.corner_vertex.reshape(-1, 3)]))
        is_found = np.zeros(len(self.corner_vertex) // 3, dtype=bool)
        for first in range(0, len(vertex), AT_ONCE):
            is_found[self._one_after_another(vertex[first : first + AT_ONCE])[0]] = True
        return np.flatnonzero(is_found)

    def _one_after_another(
        self, vertex: npt.NDArray[np.integer]
    ) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
        """The faces at some vertices (n,), and how many each of them has, (n,)."""
        first = self.start.take(vertex)
        count = self.start[1:].take(vertex) - first
        before = np.cumsum(count, dtype=np.int32) - count
        place = np.repeat(first - before, count)
        place += np.arange(len(place), dtype=np.int32)
        return self.face.take(place), count

    def _made_on(self, device: str) -> tuple[wp.array, wp.array]:
        if device_traits(device).own_memory:
            return _sorted_there(self.corners(device), None, self._vertex_count)
        return uploaded(self.start, device), uploaded(self.face, device)


def faces_at_clusters(
    around: FacesAround,
    cluster: npt.NDArray[np.integer] | wp.array,
    count: int,
    faces: npt.NDArray[np.integer] | None,
    device: str,
) -> FaceLists:
    """The faces of a mesh at the members of each cluster.

    Args:
        around: the faces.
        cluster: (V,) int32, on the host, or where the lists are made there, on the device.
        count: clusters.
        faces: (n,) int, which of them are asked for; None for all. A device that makes the lists has all of them.
        device: Warp device.
    """
    if device_traits(device).own_memory:
        return FaceLists(*_sorted_there(around.corners(device), uploaded(cluster, device), count))
    assert isinstance(cluster, np.ndarray)
    if faces is None:
        at_clusters = FacesAround(cluster[around.corner_vertex], count)
        return FaceLists(at_clusters.start, at_clusters.face)
    at_clusters = FacesAround(cluster[around.corner_vertex.reshape(-1, 3)[faces]], count)
    return FaceLists(at_clusters.start, faces[at_clusters.face].astype(np.int32))


def uploaded(values: npt.NDArray[np.integer] | wp.array, device: str) -> wp.array:
    """Whole numbers (n,) as int32 on the device; those there already as they are."""
    if isinstance(values, wp.array):
        return values
    return new_arrays.uploaded(values.astype(np.int32, copy=False), dtype=wp.int32, device=device, copy=False)


def _sorted_there(corner_vertex: wp.array, cluster: wp.array | None, count: int) -> tuple[wp.array, wp.array]:
    """The lists of all vertices, or clusters (V,) of them, on the device: faces ascend in each, as a sort keeps them.

    Args:
        corner_vertex: (3N,) int32.
        cluster: int32, below 0 for none.
        count: vertices or clusters.
    """
    device, corner_count = corner_vertex.device, len(corner_vertex)
    # A sort works between the two halves.
    key, face = (new_arrays.empty(2 * corner_count, dtype=wp.int32, device=device) for _ in range(2))
    start = new_arrays.empty(count + 1, dtype=wp.int32, device=device)
    own = new_arrays.empty(0, dtype=wp.int32, device=device) if cluster is None else cluster
    launch(face_lists.key_faces_of_corners, corner_count, [corner_vertex, own, count], [key, face], device=device)
    if corner_count:
        wp.utils.radix_sort_pairs(key, face, corner_count, 0, count.bit_length())
    launch(face_lists.start_lists, count + 1, [key, corner_count], [start], device=device)
    return start, face
