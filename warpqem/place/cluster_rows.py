"""Compressed rows: items grouped by cluster."""

from __future__ import annotations

import numpy as np
import warp as wp

from warpqem.decimation.adjacency import build_adjacency
from warpqem.kernels import cluster_rows as kernels
from warpqem.kernels import face_lists
from warpqem.mesh.grouping import order_by
from warpqem.runtime import new_arrays
from warpqem.runtime.launches import launch
from warpqem.runtime.part_launches import launch_in_parts, rows_of, starts_of

__all__ = [
    "ClusterFaces",
    "group_rows",
    "list_faces_at",
    "match_keys",
    "sum_repeated",
]


def group_rows(row: np.ndarray, row_count: int) -> tuple[np.ndarray, np.ndarray]:
    """Order that groups items by row, keeping their order within one, and where each row starts, (R+1,) int32."""
    order = order_by(row, row_count)
    start = np.zeros(row_count + 1, dtype=np.int32)
    np.cumsum(np.bincount(row, minlength=row_count), out=start[1:])
    return order, start


def sum_repeated(
    row: np.ndarray, item: np.ndarray, weight: np.ndarray, row_count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Items by row with the weights of repeated ones added.

    Args:
        row: (M,) int, the row of each entry; -1 for an entry to leave out.
        item: (M,) int.
        weight: (M,) float.
        row_count: rows R.

    Returns:
        ``start`` (R+1,) int32, ``item`` int32 ascending within a row, ``weight`` float32.
    """
    if not len(row):
        # As of most small meshes, for which the rest takes as long as of any.
        return np.zeros(row_count + 1, dtype=np.int32), np.empty(0, dtype=np.int32), np.empty(0, dtype=np.float32)
    inside = np.flatnonzero(row >= 0)
    order = inside[np.lexsort((item[inside], row[inside]))]
    row, item = row[order], item[order]
    first = np.ones(len(order), dtype=bool)
    first[1:] = (row[1:] != row[:-1]) | (item[1:] != item[:-1])
    summed = np.bincount(np.cumsum(first) - 1, weight[order]) if len(order) else np.empty(0)
    start = np.concatenate([[0], np.cumsum(np.bincount(row[first], minlength=row_count))])
    return start.astype(np.int32), item[first].astype(np.int32), summed.astype(np.float32)


def match_keys(wanted: np.ndarray, key: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every pair of a wanted key (M,) int and an item of that ``key`` (N,) int: their indices, (P,) int64 each."""
    chosen = np.flatnonzero(np.isin(key, wanted))
    order = chosen[np.argsort(key[chosen], kind="stable")]
    first, last = (np.searchsorted(key[order], wanted, side=side) for side in ("left", "right"))
    count = last - first
    entry = np.repeat(np.arange(len(wanted)), count)
    within = np.arange(len(entry)) - np.repeat(np.cumsum(count) - count, count)
    return entry, order[first[entry] + within]


class ClusterFaces:
    """The faces that have a corner in each cluster, each once: :func:`sum_repeated` for meshes of any size.

    Args:
        corner_cluster: (3N,) int32 on the device, the cluster of each corner; -1 for a corner to leave out.
        corner_weight: (3N,) float32.
        cluster_count: clusters C.
        corner_count: corners that have a cluster, where the host knows how many and a device is to sort no others; None
            for any number.

    Attributes:
        start: (C+1,) int32, where the faces of each cluster begin.
        total: (1,) int32 on the device, how many there are.
    """

    def __init__(
        self, corner_cluster: wp.array, corner_weight: wp.array, cluster_count: int, corner_count: int | None = None
    ) -> None:
        device = corner_cluster.device
        if corner_count is None:
            adjacency = build_adjacency(corner_cluster, cluster_count)
            start, corner = adjacency.start, adjacency.corner
        else:
            start, corner = _sorted_corners(corner_cluster, cluster_count, corner_count)
        count = new_arrays.zeros(cluster_count + 1, dtype=wp.int32, device=device)
        self._lists, self._corner_weight = [starts_of(start), corner], corner_weight
        launch_in_parts(kernels.count_faces, cluster_count, self._lists, [rows_of(count)], device=device)
        self.start = new_arrays.like(count)
        wp.utils.array_scan(count, self.start, inclusive=False)
        self.total = new_arrays.part(self.start, cluster_count, cluster_count + 1)

    def listed(self, room: int) -> tuple[wp.array, wp.array]:
        """``face`` int32, ascending within a cluster, and ``weight`` float32, the sum over its corners.

        There is room for so many, which are no fewer than there are.
        """
        device = self.start.device
        face = new_arrays.empty(room, dtype=wp.int32, device=device)
        weight = new_arrays.empty(room, dtype=wp.float32, device=device)
        inputs = [*self._lists, self._corner_weight, starts_of(self.start)]
        launch_in_parts(kernels.list_faces, len(self.start) - 1, inputs, [face, weight], device=device)
        return face, weight


def _sorted_corners(corner_cluster: wp.array, cluster_count: int, corner_count: int) -> tuple[wp.array, wp.array]:
    """Where the corners of each cluster begin, (C+1,) int32, and these, ascending in each: a sort on the device.

    Args:
        corner_cluster: (3N,) int32, -1 for none.
        cluster_count: clusters C.
        corner_count: how many corners have one.
    """
    device, every = corner_cluster.device, len(corner_cluster)
    before = new_arrays.empty(every, dtype=wp.int32, device=device)
    launch(face_lists.mark_corners_in_clusters, every, [corner_cluster], [before], device=device)
    wp.utils.array_scan(before, before, inclusive=True)
    # A sort works between the two halves.
    key, corner = (new_arrays.empty(2 * corner_count, dtype=wp.int32, device=device) for _ in range(2))
    inputs = [corner_cluster, before, corner_count]
    launch(face_lists.key_corners_in_clusters, every, inputs, [key, corner], device=device)
    if corner_count:
        wp.utils.radix_sort_pairs(key, corner, corner_count, 0, cluster_count.bit_length())
    start = new_arrays.empty(cluster_count + 1, dtype=wp.int32, device=device)
    launch(face_lists.start_lists, cluster_count + 1, [key, corner_count], [start], device=device)
    return start, corner


def list_faces_at(corner_cluster: np.ndarray, cluster_count: int, device: str) -> tuple[np.ndarray, np.ndarray]:
    """The faces that have a corner (3N,) int in each cluster, see :class:`ClusterFaces`: ``start`` and ``face``."""
    cluster = new_arrays.uploaded(corner_cluster, dtype=wp.int32, device=device)
    weight = new_arrays.zeros(len(cluster), dtype=wp.float32, device=device)
    faces = ClusterFaces(cluster, weight, cluster_count)
    start = faces.start.numpy()
    face, _ = faces.listed(int(start[-1]))
    return start, face.numpy()
