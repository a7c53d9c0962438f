"""Material anchors: for each output vertex, constant weights over input vertices of its cluster."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from warpqem.decimation.adjacency import group_items
from warpqem.decimation.decimate import DecimatedMesh
from warpqem.kernels import anchor as kernels
from warpqem.kernels import cluster_rows as row_kernels
from warpqem.kernels.lanes import width_of
from warpqem.runtime.device import device_traits
from warpqem.runtime.launches import launch
from warpqem.runtime.part_launches import launch_in_parts, rows_of, starts_of

__all__ = ["Anchors", "fit_anchors", "nearest_anchors"]

# An anchor uses at most so many of its cluster's vertices, the nearest to where ordering put the vertex. The small
# dense solve grows with the cube of this, and weights far from the vertex are near zero.
MAX_MEMBERS = 32


@dataclass(frozen=True)
class Anchors:
    """Anchors of C output vertices as compressed rows.

    Attributes:
        start: (C+1,) int32.
        vertex: input vertices, nearest first.
        weight: float32, sum 1 per anchor.
    """

    start: np.ndarray
    vertex: np.ndarray
    weight: np.ndarray


def nearest_members(ordered: DecimatedMesh, cluster: np.ndarray, cluster_count: int, most: int) -> Anchors:
    """The ``most`` vertices of each cluster nearest to where ordering put it over the key frames, with weight 1 / n.

    ``cluster`` (V,) is the output vertex of each input vertex, -1 where there is none.
    """
    device = ordered.position.device
    distance = _cluster_distances(ordered, device)
    eligible = np.where(_may_anchor(ordered, cluster, cluster_count), cluster, np.int32(-1))
    first = np.concatenate([[0], np.cumsum(np.bincount(eligible[eligible >= 0], minlength=cluster_count))])
    size = np.minimum(np.diff(first), most)
    start = np.concatenate([[0], np.cumsum(size)]).astype(np.int32)
    find = _find_in_order if device_traits(str(device)).in_order else _find_by_sort
    vertex = find(eligible, distance, first.astype(np.int32), start)
    return Anchors(start, vertex.numpy(), np.repeat(1.0 / size, size).astype(np.float32))


def _find_in_order(cluster: np.ndarray, distance: wp.array, first: np.ndarray, start: np.ndarray) -> wp.array:
    """The nearest vertices of each cluster, the nearest first: a thread walks all vertices of a cluster.

    Args:
        cluster: (V,) int32, -1 for a vertex to leave out.
        distance: (V,) float32.
        first: (C+1,) int32, how many vertices come before those of each cluster.
        start: (C+1,) int32, where each has its part of the result.
    """
    device = distance.device
    groups = group_items(cluster, len(start) - 1, device)
    chosen_start, vertex = wp.array(start, device=device), wp.empty(int(start[-1]), dtype=wp.int32, device=device)
    inputs = [starts_of(groups.start), groups.corner, distance, starts_of(chosen_start)]
    launch_in_parts(row_kernels.choose_nearest, len(start) - 1, inputs, [vertex], device=device)
    return vertex


def _find_by_sort(cluster: np.ndarray, distance: wp.array, first: np.ndarray, start: np.ndarray) -> wp.array:
    """The same by one sort of all vertices, which keeps the order of those as near as each other."""
    device, count, cluster_count = distance.device, len(cluster), len(start) - 1
    # A sort works between the two halves.
    keys, vertices = (wp.empty(2 * count, dtype=dtype, device=device) for dtype in (wp.int64, wp.int32))
    inputs = [wp.array(cluster, device=device), distance, cluster_count]
    launch(row_kernels.key_members, count, inputs, [keys, vertices], device=device)
    wp.utils.radix_sort_pairs(keys, vertices, count, 0, 32 + cluster_count.bit_length())
    chosen = wp.empty(int(start[-1]), dtype=wp.int32, device=device)
    inputs = [keys, vertices, *(wp.array(a, device=device) for a in (first, start))]
    launch(row_kernels.take_nearest, count, inputs, [chosen], device=device)
    return chosen


def _cluster_distances(ordered: DecimatedMesh, device: str) -> wp.array:
    """(V,) float32, squared distance over the key frames of each input vertex from where its cluster's vertex went."""
    kernel = kernels.measure_cluster_distances[width_of(ordered.position)]
    row = wp.array(ordered.row[ordered.root], device=device)
    distance = wp.empty(len(row), dtype=wp.float32, device=device)
    inputs = [rows_of(row), rows_of(ordered.key_position), ordered.position]
    launch_in_parts(kernel, len(row), inputs, [rows_of(distance)], device=device)
    return distance


def _may_anchor(ordered: DecimatedMesh, cluster: np.ndarray, cluster_count: int) -> np.ndarray:
    """(V,) bool: in a cluster with vertices on a border or seam these alone hold the anchor, so that it stays there.

    Where there are corners of seams among them, these alone do.
    """
    inside = cluster >= 0
    highest = np.zeros(cluster_count, dtype=np.int32)
    np.maximum.at(highest, cluster[inside], ordered.line_rank[inside])
    return inside & (ordered.line_rank == highest[cluster])


def nearest_anchors(ordered: DecimatedMesh, cluster: np.ndarray, cluster_count: int) -> Anchors:
    """Each vertex anchored to the one input vertex nearest to where ordering put it (exact for endpoint placement)."""
    return nearest_members(ordered, cluster, cluster_count, most=1)


def fit_anchors(
    ordered: DecimatedMesh,
    kept: np.ndarray,
    cluster: np.ndarray,
    regularisation: np.ndarray,
) -> Anchors:
    """Weights that minimise the cluster's quadrics over all key frames, regularised towards equal weights.

    Args:
        ordered: result of decimation.
        kept: (C,) int32, input vertex that each output vertex goes by.
        cluster: (V,) int32, output vertex of each input vertex, -1 where there is none.
        regularisation: (C,) stiffness towards equal weights, relative to the mean diagonal of the Gram matrix.
    """
    device = ordered.position.device
    members = nearest_members(ordered, cluster, len(kept), MAX_MEMBERS)
    size = np.diff(members.start).astype(np.int64)
    matrix_start = np.concatenate([[0], np.cumsum(size * (size + 1) // 2)])
    kernel = kernels.fit_anchor_weights[width_of(ordered.position)]
    row = wp.array(ordered.row[kept], dtype=wp.int32, device=device)
    member_start, member = (wp.array(a, device=device) for a in (members.start, members.vertex))
    first_entry = wp.array(matrix_start.astype(np.int32), device=device)
    matrix = wp.zeros(int(matrix_start[-1]), dtype=wp.float32, device=device)
    stiffness = wp.array(regularisation, dtype=wp.float32, device=device)
    weight = wp.zeros(len(members.vertex), dtype=wp.float32, device=device)
    lists = [rows_of(row), starts_of(member_start), member, starts_of(first_entry)]
    inputs = [*lists, ordered.key_position, ordered.position, ordered.quadric, rows_of(stiffness)]
    launch_in_parts(kernel, len(kept), inputs, [matrix, weight], device=device)
    return Anchors(members.start, members.vertex, weight.numpy())
