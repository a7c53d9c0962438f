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
from warpqem.place.cluster_rows import last_start, starts_of_counts
from warpqem.runtime.device import device_traits
from warpqem.runtime.launches import launch
from warpqem.runtime.part_launches import launch_in_parts, rows_of, starts_of

__all__ = ["Anchors", "Clusters", "fit_anchors", "nearest_anchors"]

# An anchor uses at most so many of its cluster's vertices, the nearest to where ordering put the vertex. The small
# dense solve grows with the cube of this, and weights far from the vertex are near zero.
MAX_MEMBERS = 32


@dataclass(frozen=True)
class Clusters:
    """Clusters of input vertices on the device.

    Attributes:
        cluster: (V,) int32, the cluster of each input vertex, -1 where there is none.
        size: (C,) int32, its input vertices.
        rank: (V,) int32, ``line_rank`` of the vertices.
        highest_rank: (C,) int32, the highest among those of a cluster.
    """

    cluster: wp.array
    size: wp.array
    rank: wp.array
    highest_rank: wp.array

    @classmethod
    def of(cls, cluster: np.ndarray, line_rank: np.ndarray, cluster_count: int, device: str) -> Clusters:
        """Count the vertices (V,) of each."""
        given = [wp.array(values, dtype=wp.int32, device=device, copy=False) for values in (cluster, line_rank)]
        found = [wp.zeros(cluster_count, dtype=wp.int32, device=device) for _ in range(2)]
        launch(row_kernels.count_members, len(cluster), given, found, device=device)
        return cls(given[0], found[0], given[1], found[1])


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

    def finish(self, kept: np.ndarray, pinned: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Anchor each pinned vertex to itself alone, also where it is not among the nearest members of its cluster.

        Args:
            kept: (C,) int32, input vertex that each output vertex goes by.
            pinned: (C,) bool.

        Returns:
            The member of each with the largest weight, (C,) int32, the nearest of equal ones; and that weight.
        """
        device, count = self.start.device, len(kept)
        flags = wp.array(pinned, dtype=wp.int32, device=device)
        heaviest = wp.empty(count, dtype=wp.int32, device=device)
        largest = wp.empty(count, dtype=wp.float32, device=device)
        launch_in_parts(
            kernels.finish_anchors,
            count,
            inputs=[starts_of(self.start), rows_of(wp.array(kept, dtype=wp.int32, device=device)), rows_of(flags)],
            outputs=[self.vertex, self.weight, rows_of(heaviest), rows_of(largest)],
            device=device,
        )
        return heaviest.numpy(), largest.numpy()


def nearest_members(ordered: DecimatedMesh, clusters: Clusters, most: int) -> tuple[wp.array, wp.array]:
    """The ``most`` vertices of each cluster nearest to where ordering put it over the key frames.

    In a cluster with vertices on a border or seam these alone hold the anchor, so that it stays there; where there are
    corners of seams among them, these alone do.

    Returns:
        ``start`` (C+1,) int32 and ``vertex`` int32, the nearest first.
    """
    device, cluster_count, vertex_count = ordered.position.device, len(clusters.size), len(clusters.cluster)
    distance = _cluster_distances(ordered, device)
    # Corners come in threes, if clusters are taken for vertices and their members for corners.
    eligible = wp.full(-(-vertex_count // 3) * 3, -1, dtype=wp.int32, device=device)
    count, size = (wp.zeros(cluster_count + 1, dtype=wp.int32, device=device) for _ in range(2))
    inputs = [clusters.cluster, clusters.rank, clusters.highest_rank]
    launch(row_kernels.mark_highest, vertex_count, inputs, [count, eligible], device=device)
    launch(row_kernels.limit_counts, cluster_count, [count, most], [size], device=device)
    start = starts_of_counts(size)
    vertex = wp.empty(last_start(start), dtype=wp.int32, device=device)
    if device_traits(str(device)).in_order:
        _find_in_order(eligible, distance, start, vertex)
    else:
        _find_by_sort(eligible, distance, starts_of_counts(count), start, vertex)
    return start, vertex


def _find_in_order(eligible: wp.array, distance: wp.array, start: wp.array, vertex_out: wp.array) -> None:
    """The nearest vertices of each cluster, the nearest first: a thread walks all vertices of a cluster.

    Args:
        eligible: (V,) int32, the cluster of each vertex, -1 for one to leave out, and up to two of these more.
        distance: (V,) float32.
        start: (C+1,) int32, where each has its part of the result.
        vertex_out: takes the vertices.
    """
    groups = build_adjacency(eligible, len(start) - 1)
    inputs = [starts_of(groups.start), groups.corner, distance, starts_of(start)]
    launch_in_parts(row_kernels.choose_nearest, len(start) - 1, inputs, [vertex_out], device=distance.device)


def _find_by_sort(
    eligible: wp.array, distance: wp.array, first: wp.array, start: wp.array, vertex_out: wp.array
) -> None:
    """The same by one sort of all vertices, which keeps the order of those as near as each other.

    ``first`` (C+1,) int32 says how many vertices come before those of each cluster.
    """
    device, count, cluster_count = distance.device, len(distance), len(start) - 1
    # A sort works between the two halves.
    keys, vertices = (wp.empty(2 * count, dtype=dtype, device=device) for dtype in (wp.int64, wp.int32))
    launch(row_kernels.key_members, count, [eligible, distance, cluster_count], [keys, vertices], device=device)
    wp.utils.radix_sort_pairs(keys, vertices, count, 0, 32 + cluster_count.bit_length())
    launch(row_kernels.take_nearest, count, [keys, vertices, first, start], [vertex_out], device=device)


def _cluster_distances(ordered: DecimatedMesh, device: str) -> wp.array:
    """(V,) float32, squared distance over the key frames of each input vertex from where its cluster's vertex went."""
    kernel = kernels.measure_cluster_distances[width_of(ordered.position)]
    row = wp.array(ordered.row[ordered.root], device=device)
    distance = wp.empty(len(row), dtype=wp.float32, device=device)
    inputs = [rows_of(row), rows_of(ordered.key_position), ordered.position]
    launch_in_parts(kernel, len(row), inputs, [rows_of(distance)], device=device)
    return distance


def nearest_anchors(ordered: DecimatedMesh, clusters: Clusters) -> Anchors:
    """Each vertex anchored to the one input vertex nearest to where ordering put it (exact for endpoint placement)."""
    start, vertex = nearest_members(ordered, clusters, most=1)
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
    member_start, member = nearest_members(ordered, clusters, MAX_MEMBERS)
    entry_count = wp.zeros(len(kept) + 1, dtype=wp.int32, device=device)
    launch(kernels.count_entries, len(kept), [member_start], [entry_count], device=device)
    first_entry = starts_of_counts(entry_count)
    row = wp.array(ordered.row[kept], dtype=wp.int32, device=device)
    matrix = wp.zeros(last_start(first_entry), dtype=wp.float32, device=device)
    stiffness = wp.array(regularisation, dtype=wp.float32, device=device)
    weight = wp.empty(len(member), dtype=wp.float32, device=device)
    fit_weights(ordered, row, Anchors(member_start, member, weight), first_entry, stiffness, matrix)
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
    reach = wp.empty((count, block_count * width), dtype=wp.float32, device=device)
    moved = wp.empty((count, block_count), dtype=wp.float32, device=device)
    lists, distances = [starts_of(anchors.start), anchors.vertex], [rows_of(reach), rows_of(moved)]
    inputs = [*lists, ordered.key_position, anchors.weight]
    launch_in_parts(kernels.measure_reach[width], moved.shape, inputs, distances, device=device)
    inputs = [starts_of(anchors.start), *distances]
    launch_in_parts(kernels.keep_within_reach, count, inputs, [anchors.weight], device=device)
