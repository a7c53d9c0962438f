"""Vertices of a mesh that are far from another one in some frame, as faces around show: found fast, and not proved."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.kernels import distance_points as kernels
from warpqem.kernels.lanes import width_of
from warpqem.measure.piece_proof import SINGLE_MARGIN
from warpqem.measure.unit_frames import UnitBlock
from warpqem.runtime.part_launches import corners_of, launch_in_parts, rows_of

__all__ = ["FacesAround", "far_points", "furthest_from", "longest_edges", "unique_pairs"]

# Points, or faces, that are worth a thread: some hundred nanoseconds each.
MIN_POINTS = 1024


class FacesAround:
    """The faces at each vertex of a mesh, as compressed rows.

    Args:
        faces: (N, 3) int.
        vertex_count: vertices V.
    """

    def __init__(self, faces: npt.NDArray[np.integer], vertex_count: int) -> None:
        self.corner_vertex = np.ascontiguousarray(faces, dtype=np.int32).ravel()
        self.start = np.zeros(vertex_count + 1, dtype=np.int32)
        np.cumsum(np.bincount(self.corner_vertex, minlength=vertex_count), out=self.start[1:])
        self.face = (np.argsort(self.corner_vertex, kind="stable") // 3).astype(np.int32)

    def of(self, vertex: npt.NDArray[np.integer]) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int64]]:
        """The faces at some vertices, and of which of them (n,) each is, one after another."""
        first, count = self.start[vertex], np.diff(self.start)[vertex]
        row = np.repeat(np.arange(len(vertex)), count)
        place = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count) + first[row]
        return self.face[place], row

    def second_ring(self, vertex: npt.NDArray[np.integer]) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
        """The faces at the faces at some vertices, as compressed rows."""
        face, row = self.of(vertex)
        around = unique_pairs(np.repeat(row, 3), self.corner_vertex.reshape(-1, 3)[face].ravel())
        face, of_around = self.of(around[1])
        pair = unique_pairs(around[0][of_around], face)
        start = np.searchsorted(pair[0], np.arange(len(vertex) + 1)).astype(np.int32)
        return start, pair[1].astype(np.int32)


def unique_pairs(
    first: npt.NDArray[np.integer], second: npt.NDArray[np.integer]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """The different ones of some pairs of numbers from 0 on (n,), ascending; by keys, ten times as fast as by rows."""
    count = int(second.max(initial=0)) + 1
    first_found, second_found = np.divmod(np.unique(first.astype(np.int64) * count + second), count)
    return first_found, second_found


def far_points(
    own: UnitBlock,
    other: UnitBlock,
    around: FacesAround,
    point: npt.NDArray[np.integer],
    vertex: npt.NDArray[np.integer],
    limit: float,
    device: str,
) -> npt.NDArray[np.int64]:
    """Points of ``own`` that in some frame are beyond the limit of the faces of ``other`` around one of its vertices.

    Args:
        own: frames of one mesh.
        other: the same frames of the other one.
        around: its faces.
        point: (n,) int, vertices of ``own``.
        vertex: (n,) int, a vertex of ``other`` near each.
        limit: distance.
        device: Warp device.

    Returns:
        Indices into ``point`` (m,).
    """
    limit += SINGLE_MARGIN
    furthest = furthest_from(own, other, around, point, vertex, (around.start, around.face), limit, device)
    far = np.flatnonzero(furthest > limit)
    if len(far):
        # The nearest face may be one further on.
        lists = around.second_ring(vertex[far])
        furthest = furthest_from(own, other, around, point[far], np.arange(len(far)), lists, limit, device)
        far = far[furthest > limit]
    return far


def furthest_from(
    own: UnitBlock,
    other: UnitBlock,
    around: FacesAround,
    point: npt.NDArray[np.integer],
    row: npt.NDArray[np.integer],
    lists: tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]],
    limit: float,
    device: str,
) -> npt.NDArray[np.float32]:
    """How far points are at most, over the frames, from the nearest of some faces.

    Args:
        own: frames of one mesh, or of points.
        other: the same frames of the other mesh.
        around: its faces.
        point: (n,) int, points of ``own``.
        row: (n,) int, the row of the lists with the faces for each.
        lists: where each row starts, (R+1,) int32, and faces of ``other``, int32.
        limit: points within it in all frames of a block are looked at no closer.
        device: Warp device.

    Returns:
        (n,) float32; of points within the limit anything that is.
    """
    if not len(point):
        return np.empty(0, dtype=np.float32)
    furthest = wp.empty(len(point), dtype=wp.float32, device=device)
    corner_vertex, start, face = (
        wp.array(values, dtype=wp.int32, device=device, copy=False) for values in (around.corner_vertex, *lists)
    )
    point_device, row_device = (wp.array(a.astype(np.int32), dtype=wp.int32, device=device) for a in (point, row))
    inputs = [own.lanes, other.lanes, corner_vertex, rows_of(point_device), rows_of(row_device), start, face]
    launch_in_parts(
        kernels.distances_of_points[width_of(own.lanes)],
        len(point),
        [*inputs, limit**2],
        [rows_of(furthest)],
        device=device,
        min_items=MIN_POINTS,
    )
    found: npt.NDArray[np.float32] = np.sqrt(furthest.numpy())
    return found


def longest_edges(block: UnitBlock, faces: npt.NDArray[np.integer], device: str) -> npt.NDArray[np.float32]:
    """The length of the longest edge of each face (N, 3) in any frame of a block, (N,), in its units."""
    corner_vertex = wp.array(np.ascontiguousarray(faces).ravel(), dtype=wp.int32, device=device)
    squared = wp.empty(len(faces), dtype=wp.float32, device=device)
    launch_in_parts(
        kernels.longest_edges[width_of(block.lanes)],
        len(faces),
        [block.lanes, corners_of(corner_vertex)],
        [rows_of(squared)],
        device=device,
        min_items=MIN_POINTS,
    )
    length: npt.NDArray[np.float32] = np.sqrt(squared.numpy())
    return length
