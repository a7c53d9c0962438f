"""Connected components of the mesh on the device."""

from __future__ import annotations

import warp as wp

from warpqem.kernels import components as kernels
from warpqem.kernels.topology import VertexAdjacency
from warpqem.runtime import new_arrays
from warpqem.runtime.launches import launch

__all__ = ["ComponentForest"]


class ComponentForest:
    """The components of a mesh, each by its lowest vertex.

    Args:
        corner_vertex: (3N,) int32, no face dead.
        adjacency: corners of the V vertices.
        count: (1,) int32 on the device, 0: gets the number of components with a face.

    Attributes:
        lowest: (V,) int32, the lowest vertex of each one's component.
    """

    def __init__(self, corner_vertex: wp.array, adjacency: VertexAdjacency, count: wp.array) -> None:
        self._device, vertex_count = corner_vertex.device, len(adjacency.start)
        self.lowest, self._is_root = (
            new_arrays.empty(vertex_count, dtype=wp.int32, device=self._device) for _ in range(2)
        )
        launch(kernels.begin_trees, vertex_count, [], [self.lowest], device=self._device)
        launch(kernels.join_faces, len(corner_vertex) // 3, [corner_vertex], [self.lowest], device=self._device)
        outputs = [self.lowest, count, self._is_root]
        launch(kernels.close_trees, vertex_count, [adjacency], outputs, device=self._device)

    def number(self) -> wp.array:
        """(V,) int32, components numbered from 0 by their lowest vertices; one without a face has a number, too."""
        before, component = wp.empty_like(self._is_root), wp.empty_like(self._is_root)
        wp.utils.array_scan(self._is_root, before, inclusive=False)
        launch(kernels.number_components, len(before), [self.lowest, before], [component], device=self._device)
        return component
