"""Vertex stars on the device: built anew from the faces once a pass."""

from __future__ import annotations

import warp as wp

from warpqem.kernels import topology as kernels

__all__ = ["Stars", "build_stars", "classify_vertices"]


class Stars:
    """Buffers for the stars of ``vertex_count`` vertices and up to ``face_count`` faces, reused from pass to pass.

    Attributes:
        start: (V+1,) int32, the first entry of each vertex's list; the last entry is the number of corners.
        corner: (3N,) int32, corners by vertex, ascending within a vertex.
    """

    def __init__(self, vertex_count: int, face_count: int, device: str) -> None:
        self.device = device
        self.start = wp.zeros(vertex_count + 1, dtype=wp.int32, device=device)
        self.corner = wp.empty(3 * face_count, dtype=wp.int32, device=device)
        self._cursor = wp.zeros(vertex_count + 1, dtype=wp.int32, device=device)
        # Launches for one corner array and length, recorded: a replay costs a fifth of a launch.
        self._recorded: dict[tuple[int, int], tuple[wp.Launch, wp.Launch]] = {}

    def build(self, corner_vertex: wp.array, half_edge_count: int) -> None:
        """Fill the lists from the first ``half_edge_count`` corners; corners with vertex -1 are left out."""
        device = self.device
        key = (corner_vertex.ptr, half_edge_count)
        if key not in self._recorded:
            self._recorded[key] = self._record(corner_vertex, half_edge_count)
        count, fill = self._recorded[key]
        self._cursor.zero_()
        count.launch()
        wp.utils.array_scan(self._cursor, self.start, inclusive=False)
        wp.copy(self._cursor, self.start)
        fill.launch()
        # One CPU thread fills the lists in ascending order; on a GPU threads arrive in any order.
        if not wp.get_device(device).is_cpu:
            vertex_count = len(self.start) - 1
            wp.launch(kernels.sort_stars, dim=vertex_count, inputs=[self.start], outputs=[self.corner], device=device)

    def _record(self, corner_vertex: wp.array, half_edge_count: int) -> tuple[wp.Launch, wp.Launch]:
        count, fill = (
            wp.launch(
                kernel,
                dim=half_edge_count,
                inputs=[corner_vertex],
                outputs=outputs,
                device=self.device,
                record_cmd=True,
            )
            for kernel, outputs in (
                (kernels.count_corners, [self._cursor]),
                (kernels.fill_stars, [self._cursor, self.corner]),
            )
        )
        return count, fill


def build_stars(corner_vertex: wp.array, vertex_count: int) -> Stars:
    """Stars of a mesh given as ``corner_vertex`` (3N,) int32."""
    half_edge_count = len(corner_vertex)
    stars = Stars(vertex_count, half_edge_count // 3, corner_vertex.device)
    stars.build(corner_vertex, half_edge_count)
    return stars


def classify_vertices(corner_vertex: wp.array, stars: Stars, vertex_flags: wp.array) -> wp.array:
    """Add BORDER and FROZEN to ``vertex_flags`` (V,) int32; return (3N,) int32, 1 at each border half-edge."""
    border = wp.zeros(len(corner_vertex), dtype=wp.int32, device=corner_vertex.device)
    wp.launch(
        kernels.classify_vertices,
        dim=len(vertex_flags),
        inputs=[corner_vertex, stars.start, stars.corner],
        outputs=[vertex_flags, border],
        device=corner_vertex.device,
    )
    return border
