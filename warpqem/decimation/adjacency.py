"""Vertex-corner adjacency on the device: built from the faces, then kept up by the kernels of a pass."""

from __future__ import annotations

from typing import Any

import warp as wp

from warpqem.decimation.recorded_launches import LaunchGroup, part_work, record_shared, run_once
from warpqem.kernels import topology as kernels
from warpqem.kernels.topology import VertexAdjacency
from warpqem.runtime import new_arrays
from warpqem.runtime.cpu_threads import thread_count
from warpqem.runtime.device import device_traits
from warpqem.runtime.launches import Recorder
from warpqem.runtime.part_launches import FIRST_ITEM, launch_in_parts

__all__ = ["Adjacency", "build_adjacency", "classify_vertices"]


class Adjacency:
    """Buffers for the corners of ``vertex_count`` vertices and as many faces as there are, reused from pass to pass.

    Args:
        corner_vertex: (3N,) int32, vertex of each corner; -1 in a dead face, which is left out.
        face_count: (1,) int32, how many of the N faces there are now.
        vertex_count: vertices V.
        spare: entries of the pool besides the 3N corners of the faces, for the lists of vertices that move.

    Attributes:
        start: (V+1,) int32, the first entry of each vertex's list as built; the last entry is the number of corners.
        corner: (3N + spare,) int32, corners by vertex, ascending within a vertex.
        lists: the same as the kernels of a pass see and change it.
    """

    def __init__(self, corner_vertex: wp.array, face_count: wp.array, vertex_count: int, spare: int = 0) -> None:
        self._corner_vertex, self._face_count, self._device = corner_vertex, face_count, corner_vertex.device
        self.start = new_arrays.zeros(vertex_count + 1, dtype=wp.int32, device=self._device)
        self.corner = new_arrays.empty(len(corner_vertex) + spare, dtype=wp.int32, device=self._device)
        self.lists = VertexAdjacency()
        self.lists.start, self.lists.end = (
            new_arrays.empty(vertex_count, dtype=wp.int32, device=self._device) for _ in range(2)
        )
        self.lists.corner, self.lists.used = self.corner, new_arrays.zeros(1, dtype=wp.int32, device=self._device)
        self._in_order = device_traits(self._device).in_order
        if not self._in_order:
            # A sort works between the two halves.
            self._keys, self._sorted = (
                new_arrays.empty(2 * len(corner_vertex), dtype=wp.int32, device=self._device) for _ in range(2)
            )

    def launch_groups(self, part_count: int) -> list[LaunchGroup]:
        """What builds the lists, in ``part_count`` parts.

        Threads in order put each corner behind those of its vertex that came before, one thread in a single launch;
        others leave the order to a sort that keeps it among equal keys. Either way a list is ascending.
        """
        if not self._in_order:
            return [LaunchGroup(self._sort), LaunchGroup(self._hand_out)]
        if part_count == 1:
            return [LaunchGroup(self._build)]
        cursor = new_arrays.zeros(len(self.start), dtype=wp.int32, device=self._device)

        def count(recorder: Recorder, part: int) -> None:
            self._record(recorder, kernels.count_corners, [cursor], part, part_count)

        def scan(recorder: Recorder, _: int) -> None:
            recorder.scan(self.start, cursor)
            recorder.copy(cursor, self.start)

        def fill(recorder: Recorder, part: int) -> None:
            self._record(recorder, kernels.fill_adjacency, [cursor, self.corner], part, part_count)

        return [
            LaunchGroup(lambda recorder, _: recorder.zero(cursor)),
            LaunchGroup(count, part_count),
            LaunchGroup(scan),
            LaunchGroup(fill, part_count),
            LaunchGroup(self._hand_out),
        ]

    def _build(self, recorder: Recorder, _: int) -> None:
        recorder.launch(kernels.build_lists, 1, [self._corner_vertex, self._face_count], [self.start, self.lists])

    def _record(self, recorder: Recorder, kernel: wp.Kernel, outputs: list[Any], part: int, part_count: int) -> None:
        work = part_work(part, part_count, self._device)
        record_shared(recorder, kernel, [self._corner_vertex, self._face_count], work, outputs)

    def _hand_out(self, recorder: Recorder, _: int) -> None:
        vertex_count = len(self.start) - 1
        recorder.copy(self.lists.start, self.start, count=vertex_count)
        recorder.copy(self.lists.end, self.start, source_offset=1, count=vertex_count)
        recorder.copy(self.lists.used, self.start, source_offset=vertex_count, count=1)

    def _sort(self, recorder: Recorder, _: int) -> None:
        corner_count, vertex_count = len(self._corner_vertex), len(self.start) - 1
        work = part_work(0, 1, self._device)
        inputs = [self._corner_vertex, self._face_count, vertex_count]
        record_shared(recorder, kernels.list_corners, inputs, work, [self._keys, self._sorted])
        recorder.sort_pairs(self._keys, self._sorted, corner_count, vertex_count.bit_length())
        record_shared(recorder, kernels.find_starts, [self._keys, corner_count], work, [self.start])
        recorder.copy(self.corner, self._sorted, count=corner_count)


def build_adjacency(
    corner_vertex: wp.array, vertex_count: int, face_count: wp.array | None = None, spare: int = 0
) -> Adjacency:
    """Adjacency of a mesh given as ``corner_vertex`` (3N,) int32: of all faces, or of the first ``face_count`` (1,)."""
    device = corner_vertex.device
    if face_count is None:
        face_count = new_arrays.uploaded([len(corner_vertex) // 3], dtype=wp.int32, device=device)
    adjacency = Adjacency(corner_vertex, face_count, vertex_count, spare)
    run_once(adjacency.launch_groups(thread_count(device)), device)
    return adjacency


def classify_vertices(corner_vertex: wp.array, adjacency: Adjacency, vertex_flags: wp.array) -> wp.array:
    """Add BORDER and NON_MANIFOLD to ``vertex_flags`` (V,) int32; return (3N,) int32, 1 at each border half-edge."""
    device = corner_vertex.device
    border = new_arrays.zeros(len(corner_vertex), dtype=wp.int32, device=device)
    inputs = [corner_vertex, adjacency.lists, FIRST_ITEM]
    launch_in_parts(kernels.classify_vertices, len(vertex_flags), inputs, [vertex_flags, border], device=device)
    return border
