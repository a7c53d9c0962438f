"""Material anchors: for each output vertex, constant weights over input vertices of its cluster."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from warpqem.decimation.adjacency import build_adjacency
from warpqem.decimation.decimate import DecimatedMesh
from warpqem.kernels import anchor as kernels
from warpqem.kernels import cluster_rows as row_kernels
from warpqem.kernels.lanes import width_of
from warpqem.runtime import new_arrays
from warpqem.runtime.device import device_traits
from warpqem.runtime.launches import launch
from warpqem.runtime.part_launches import launch_in_parts, rows_of, starts_of

__all__ = ["Anchors", "Clusters", "fit_anchors", "nearest_anchors"]

# An anchor uses at most so many of its cluster's vertices, the nearest to where ordering put the vertex. The small
# dense solve grows with the cube of this, and weights far from the vertex are near zero.
MAX_MEMBERS = 32
# Vertices that are counted at once: NumPy copies their numbers, and new memory for all takes longer than the rest.
AT_ONCE = 16384


@dataclass(frozen=True)
class Clusters:
    """Clusters of input vertices.

    In a cluster with vertices on a border or seam these alone hold the anchor, so that it stays there; where there are
    corners of seams among them, these alone do.

    Attributes:
        cluster: (V,) int32 on the device, the cluster of each input vertex, -1 where there is none.
        holder: int32 on the device, the same of vertices that hold the anchor, -1 for others, and up to two of these
            more, as corners come in threes.
        size: (C,) int32, input vertices of each cluster.
        highest_rank: (C,) int32, the highest ``line_rank`` among them.
        holder_count: (C,) int32, how many hold the anchor.
        row: (V,) int32 on the device, the row that each input vertex's cluster has in what ordering left; None where
            the host is to look.
    """

    cluster: wp.array
    holder: wp.array
    size: np.ndarray
    highest_rank: np.ndarray
    holder_count: np.ndarray
    row: wp.array | None = None

    @classmethod
    def of(cls, cluster: np.ndarray, line_rank: np.ndarray, cluster_count: int, device: str) -> Clusters:
        """Count the vertices (V,) of each; hardly a vertex has a rank above 0."""
        # The last place is of vertices without one.
        size = np.zeros(cluster_count + 1, dtype=np.int32)
        for first in range(0, len(cluster), AT_ONCE):
            # A number of the same type is added ten times as fast.
            np.add.at(size, cluster[first : first + AT_ONCE], np.int32(1))
        ranked = np.flatnonzero(line_rank > 0)
        ranked = ranked[cluster.take(ranked) >= 0]
        there, ranks = (
            new_arrays.uploaded(values, dtype=wp.int32, device=device, copy=False) for values in (cluster, line_rank)
        )
        return cls.known(there, ranks, size[:-1], cluster.take(ranked), line_rank.take(ranked))

    @classmethod
    def known(
        cls,
        cluster: wp.array,
        line_rank: wp.array,
        size: np.ndarray,
        owner: np.ndarray,
        rank: np.ndarray,
        row: wp.array | None = None,
    ) -> Clusters:
        """Those of vertices on a device.

        Args:
            cluster: see above.
            line_rank: (V,) int32 on the device.
            size: see above.
            owner: (n,) int, the clusters of all vertices in one that have a rank above 0.
            rank: (n,) int, their ranks.
            row: see above.
        """
        device, cluster_count = cluster.device, len(size)
        highest_rank = np.zeros(cluster_count, dtype=np.int32)
        np.maximum.at(highest_rank, owner, rank)
        highest = np.bincount(owner[rank == highest_rank[owner]], minlength=cluster_count)
        holder_count = np.where(highest_rank > 0, highest, size).astype(np.int32)
        holder = new_arrays.full(-(-len(cluster) // 3) * 3, -1, dtype=wp.int32, device=device)
        inputs = [cluster, line_rank, new_arrays.uploaded(highest_rank, dtype=wp.int32, device=device)]
        launch(row_kernels.choose_highest, len(cluster), inputs, [holder], device=device)
        return cls(cluster, holder, size, highest_rank, holder_count, row)


@dataclass(frozen=True)
class Anchors:
    """Anchors of C output vertices as compressed rows on the device.

    Attributes:
        start: (C+1,) int32.
        vertex: input vertices, nearest first.
        weight: float32, sum 1 per anchor.
    """

    start: wp.array
    vertex: wp.array
    weight: wp.array

    def finish(self, kept: np.ndarray, pinned: np.ndarray) -> wp.array:
        """Anchor each pinned vertex to itself alone, also where it is not among the nearest members of its cluster.

        Args:
            kept: (C,) int32, input vertex that each output vertex goes by.
            pinned: (C,) bool.

        Returns:
            Of each the member with the largest weight, (C,) int32 on the device, the nearest of equal ones.
        """
        device, count = self.start.device, len(kept)
        flags = new_arrays.uploaded(pinned, dtype=wp.int32, device=device)
        heaviest = new_arrays.empty(count, dtype=wp.int32, device=device)
        launch_in_parts(
            kernels.finish_anchors,
            count,
            inputs=[
                starts_of(self.start),
                rows_of(new_arrays.uploaded(kept, dtype=wp.int32, device=device)),
                rows_of(flags),
            ],
            outputs=[self.vertex, self.weight, rows_of(heaviest)],
            device=device,
        )
        return heaviest


def nearest_members(ordered: DecimatedMesh, clusters: Clusters, most: int) -> tuple[np.ndarray, wp.array, wp.array]:
    """The ``most`` vertices of each cluster nearest to where ordering put it over the key frames, of its holders.

    Returns:
        How many there are, (C,) int; ``start`` (C+1,) int32 and ``vertex`` int32 on the device, the nearest first.
    """
    device = ordered.position.device
    distance = _cluster_distances(ordered, clusters.row, device)
    size = np.minimum(clusters.holder_count, most)
    starts = _starts(size)
    start = new_arrays.uploaded(starts, dtype=wp.int32, device=device)
    vertex = new_arrays.empty(int(starts[-1]), dtype=wp.int32, device=device)
    if device_traits(str(device)).in_order:
        _find_in_order(clusters.holder, distance, start, vertex)
    else:
        first = new_arrays.uploaded(_starts(clusters.holder_count), dtype=wp.int32, device=device)
        _find_by_sort(clusters.holder, distance, first, start, vertex)
    return size, start, vertex


def _starts(count: np.ndarray) -> np.ndarray:
    """Where the items of each of C groups begin and the last end, (C+1,) int32, of their counts (C,)."""
    start = np.zeros(len(count) + 1, dtype=np.int32)
    np.cumsum(count, out=start[1:])
    return start


def _find_in_order(holder: wp.array, distance: wp.array, start: wp.array, vertex_out: wp.array) -> None:
    """The nearest vertices of each cluster, the nearest first: a thread walks all vertices of a cluster.

    Args:
        holder: see :class:`Clusters`.
        distance: (V,) float32.
        start: (C+1,) int32, where each has its part of the result.
        vertex_out: takes the vertices.
    """
    groups = build_adjacency(holder, len(start) - 1)
    inputs = [starts_of(groups.start), groups.corner, distance, starts_of(start)]
    launch_in_parts(row_kernels.choose_nearest, len(start) - 1, inputs, [vertex_out], device=distance.device)


def _find_by_sort(holder: wp.array, distance: wp.array, first: wp.array, start: wp.array, vertex_out: wp.array) -> None:
    """The same by one sort of all vertices, which keeps the order of those as near as each other.

    ``first`` (C+1,) int32 says how many vertices come before those of each cluster.
    """
    device, count, cluster_count = distance.device, len(distance), len(start) - 1
    # A sort works between the two halves.
    keys, vertices = (new_arrays.empty(2 * count, dtype=dtype, device=device) for dtype in (wp.int64, wp.int32))
    launch(row_kernels.key_members, count, [holder, distance, cluster_count], [keys, vertices], device=device)
    wp.utils.radix_sort_pairs(keys, vertices, count, 0, 32 + cluster_count.bit_length())
    launch(row_kernels.take_nearest, count, [keys, vertices, first, start], [vertex_out], device=device)


def _cluster_distances(ordered: DecimatedMesh, row: wp.array | None, device: str) -> wp.array:
    """(V,) float32, squared distance over the key frames of each input vertex from where its cluster's vertex went.

    ``row`` (V,) int32 says which row that has, None to look.
    """
    kernel = kernels.measure_cluster_distances[width_of(ordered.position)]
    if row is None:
        row = new_arrays.uploaded(ordered.row.take(ordered.root), dtype=wp.int32, device=device)
    distance = new_arrays.empty(len(row), dtype=wp.float32, device=device)
    inputs = [rows_of(row), rows_of(ordered.key_position), ordered.position]
    launch_in_parts(kernel, len(row), inputs, [rows_of(distance)], device=device)
    return distance


def nearest_anchors(ordered: DecimatedMesh, clusters: Clusters) -> Anchors:
    """Each vertex anchored to the one input vertex nearest to where ordering put it (exact for endpoint placement)."""
    _, start, vertex = nearest_members(ordered, clusters, most=1)
    return Anchors(start, vertex, wp.ones(len(vertex), dtype=wp.float32, device=start.device))


def fit_anchors(
    ordered: DecimatedMesh,
    kept: np.ndarray,
    clusters: Clusters,
    regularisation: np.ndarray,
) -> Anchors:
    """Weights that minimise the cluster's quadrics over all key frames, regularised towards equal weights.

    Args:
        ordered: result of decimation.
        kept: (C,) int32, input vertex that each output vertex goes by.
        clusters: what each of them stands for.
        regularisation: (C,) stiffness towards equal weights, relative to the mean diagonal of the Gram matrix.
    """
    device = ordered.position.device
    size, member_start, member = nearest_members(ordered, clusters, MAX_MEMBERS)
    first_entry = _starts(size * (size + 1) // 2)
    row = new_arrays.uploaded(ordered.row[kept], dtype=wp.int32, device=device)
    matrix = new_arrays.zeros(int(first_entry[-1]), dtype=wp.float32, device=device)
    stiffness = new_arrays.uploaded(regularisation, dtype=wp.float32, device=device)
    weight = new_arrays.empty(len(member), dtype=wp.float32, device=device)
    starts = new_arrays.uploaded(first_entry, dtype=wp.int32, device=device)
    fit_weights(ordered, row, Anchors(member_start, member, weight), starts, stiffness, matrix)
    return Anchors(member_start, member, weight)


def fit_weights(
    ordered: DecimatedMesh,
    row: wp.array,
    anchors: Anchors,
    matrix_start: wp.array,
    regularisation: wp.array,
    matrix: wp.array,
) -> None:
    """Find the weights of anchors whose members are known.

    Args:
        ordered: see :func:`fit_anchors`.
        row: (C,) int32, rows of the clusters in what ordering left.
        anchors: takes the weights.
        matrix_start: (C+1,) int32, where the packed Gram matrix of each cluster begins.
        regularisation: (C,) float32.
        matrix: float32 zeros, the matrices.
    """
    device, count, (_, block_count) = row.device, len(row), ordered.position.shape
    width, lanes = width_of(ordered.position), device_traits(str(row.device)).warp_threads
    lists = [rows_of(row), starts_of(anchors.start), anchors.vertex, starts_of(matrix_start)]
    inputs = [*lists, ordered.key_position, ordered.position, ordered.quadric]
    fill, solve = kernels.fill_gram_matrices[width], kernels.solve_for_weights[width]
    launch_in_parts(fill, (count, lanes), [*inputs, lanes], [matrix], device=device)
    solved = [matrix, anchors.weight]
    launch_in_parts(solve, (count, lanes), [*inputs, rows_of(regularisation)], solved, device=device)
    reach = new_arrays.empty((count, block_count * width), dtype=wp.float32, device=device)
    moved = new_arrays.empty((count, block_count), dtype=wp.float32, device=device)
    lists, distances = [starts_of(anchors.start), anchors.vertex], [rows_of(reach), rows_of(moved)]
    inputs = [*lists, ordered.key_position, anchors.weight]
    launch_in_parts(kernels.measure_reach[width], moved.shape, inputs, distances, device=device)
    inputs = [starts_of(anchors.start), *distances]
    launch_in_parts(kernels.keep_within_reach, count, inputs, [anchors.weight], device=device)
