"""Placement: the output vertices of an ordered mesh, and its faces."""

from __future__ import annotations

import numpy as np
import warp as wp

from warpqem.decimation.decimate import DecimatedMesh
from warpqem.decimation.quadric_sums import QuadricSums
from warpqem.frames.blocks import block_width
from warpqem.kernels import placement as kernels
from warpqem.kernels.lanes import width_of
from warpqem.mesh.indexing import put_at, taken
from warpqem.mesh.mesh_input import AnimatedMesh
from warpqem.place.block_placer import PlacedBlocks, PlacedFrames
from warpqem.place.cluster_parts import ClusterParts
from warpqem.place.clusters import ClusterPlacer, PlaceSettings
from warpqem.runtime import new_arrays
from warpqem.runtime.launches import launch

__all__ = ["Placer"]


class Placer(ClusterPlacer):
    """Places the output vertices of one ordered mesh in any block of frames.

    Args:
        faces: (N, 3) int32, the input's faces.
        ordered: result of decimation.
        quadric_scale: (V,) float32, scale of each input vertex's quadric.
        pinned: (V,) bool, input vertices that keep their position.
        settings: see :class:`PlaceSettings`.
        device: Warp device.
        sums: quadrics of other vertices that count at a vertex too; None for none.

    Attributes:
        vertex_map: (V,) int32, input vertex to output vertex, -1 for a vertex without a face.
        faces: (N', 3) int32 over output vertices.
    """

    def __init__(
        self,
        faces: np.ndarray,
        ordered: DecimatedMesh,
        quadric_scale: np.ndarray,
        pinned: np.ndarray,
        settings: PlaceSettings,
        device: str,
        sums: QuadricSums | None = None,
    ) -> None:
        # Output vertices keep the order of the input vertices they go by.
        is_kept = np.zeros(len(ordered.root), dtype=bool)
        put_at(is_kept, ordered.faces.ravel(), True)
        kept = np.flatnonzero(is_kept)
        index = np.full(len(ordered.root), -1, dtype=np.int32)
        index[kept] = np.arange(len(kept), dtype=np.int32)
        self.vertex_map = taken(index, ordered.root)
        self.faces = index.take(ordered.faces)
        parts = ClusterParts.of(faces, ordered, self.vertex_map, len(kept), quadric_scale, device)
        super().__init__(ordered, kept, parts, quadric_scale, pinned, settings, device, sums)
        self._out_corner_vertex = new_arrays.uploaded(self.faces.ravel(), dtype=wp.int32, device=device)

    def count_flips(self, placed: PlacedBlocks) -> wp.array:
        """Faces of each frame that face away from the input, (n,) int32 on the device."""
        block_count, width = placed.points.shape[1], width_of(placed.points)
        count = new_arrays.zeros(block_count * width, dtype=wp.int32, device=self.device)
        launch(
            kernels.count_flips[width],
            dim=(len(self.faces), block_count),
            inputs=[placed.points, placed.normals, self._out_corner_vertex],
            outputs=[count],
            device=self.device,
        )
        return new_arrays.part(count, 0, len(placed.source))

    def to_blocks(self, mesh: AnimatedMesh, placed: PlacedFrames) -> PlacedBlocks:
        """Frames that were kept on the host, on the device again."""
        return placed.to_blocks(block_width(mesh.frame_count, self.device), self.copied)
