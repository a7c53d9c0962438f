"""The place stage: one pass over all frames, a block of frames at a time.

Memory is that of the block and of the clusters; the number of frames does not matter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import warp as wp

from warpqem.frame_blocks import pack_frames, unpack_frames
from warpqem.kernels import placement as kernels
from warpqem.kernels.lanes import width_of
from warpqem.mesh_input import AnimatedMesh
from warpqem.order.quadrics import CONSTRAINT_WEIGHT
from warpqem.order.stage import OrderedMesh
from warpqem.parallel import launch_parts
from warpqem.place.anchors import Anchors, fit_anchors, nearest_anchors
from warpqem.place.rows import sum_repeated

__all__ = ["PlaceSettings", "PlacedFrames", "Placer", "frame_blocks"]

# Frames are placed in blocks of so many bytes of input: large enough to keep any device busy, small beside its memory.
BLOCK_BYTES = 64 * 2**20


@dataclass(frozen=True)
class PlaceSettings:
    """How vertices are placed.

    Attributes:
        epsilon: pull towards the material anchor, relative to the quadric; higher is steadier.
        regularisation: pull of the anchor's weights towards equal ones.
        endpoint: every output vertex is an input vertex.
    """

    epsilon: float
    regularisation: float
    endpoint: bool


@dataclass(frozen=True)
class PlacedFrames:
    """Placed frames: ``points`` (F, C, 3) float32, in diagonals, and area-weighted normals of the input's faces there.

    A normal (F, C, 3) is the sum over the faces of the vertex's cluster, twice their area long.
    """

    points: np.ndarray
    normals: np.ndarray


def frame_blocks(frame_count: int, vertex_count: int) -> Iterator[slice]:
    """Consecutive blocks of frames of bounded size."""
    size = max(1, BLOCK_BYTES // (12 * vertex_count))
    for first in range(0, frame_count, size):
        yield slice(first, min(first + size, frame_count))


class Placer:
    """Places the output vertices of one ordered mesh in any block of frames.

    Args:
        faces: (N, 3) int32, the input's faces.
        ordered: result of the order stage.
        quadric_scale: (V,) float32, scale of each input vertex's quadric.
        pinned: (V,) bool, input vertices that keep their position.
        settings: see :class:`PlaceSettings`.
        device: Warp device.

    Attributes:
        free: (C,) bool, output vertices that may leave the place that their quadrics give them: those that stand for
            several input vertices, on no border or seam, and not pinned.
        nearest: (C,) int32, an input vertex of each cluster near to its anchor.
        vertex_map: (V,) int32, input vertex to output vertex, -1 for a vertex without a face.
        faces: (N', 3) int32 over output vertices.
    """

    def __init__(
        self,
        faces: np.ndarray,
        ordered: OrderedMesh,
        quadric_scale: np.ndarray,
        pinned: np.ndarray,
        settings: PlaceSettings,
        device: str,
    ) -> None:
        self._settings, self._device = settings, device
        # Output vertices keep the order of the input vertices they go by.
        kept, out_faces = np.unique(ordered.faces, return_inverse=True)
        index = np.full(len(ordered.root), -1, dtype=np.int32)
        index[kept] = np.arange(len(kept), dtype=np.int32)
        self.vertex_map = index[ordered.root]
        self.faces = out_faces.reshape(-1, 3).astype(np.int32)
        self._vertex_count = len(kept)
        if settings.endpoint:
            anchors = nearest_anchors(ordered, self.vertex_map, len(kept))
            solved = np.zeros(len(kept), dtype=np.int32)
        else:
            anchors = fit_anchors(ordered, kept, self.vertex_map, settings.regularisation)
            anchors = _pin(anchors, kept, pinned)
            # A vertex alone in its cluster lies on all its planes: it is its own optimum.
            alone = np.bincount(self.vertex_map[self.vertex_map >= 0], minlength=len(kept)) == 1
            solved = (~alone & ~pinned[kept]).astype(np.int32)
        on_line = np.zeros(len(kept), dtype=bool)
        on_line[self.vertex_map[(ordered.line_rank > 0) & (self.vertex_map >= 0)]] = True
        self.free = (solved == 1) & ~on_line
        self.nearest = anchors.vertex[_heaviest(anchors)]
        # An anchor that is one input vertex, not solved for, is copied, so that it keeps its bits.
        single = np.flatnonzero((solved == 0) & (np.maximum.reduceat(anchors.weight, anchors.start[:-1]) == 1.0))
        self._copied = single
        self._copied_from = self.nearest[single]
        self._clusters = self._gather_clusters(faces, ordered.constrained, quadric_scale, anchors, solved)
        self._corner_vertex = wp.array(faces.ravel(), dtype=wp.int32, device=device)
        self._out_corner_vertex = wp.array(self.faces.ravel(), dtype=wp.int32, device=device)

    def _gather_clusters(
        self,
        faces: np.ndarray,
        constrained: np.ndarray,
        quadric_scale: np.ndarray,
        anchors: Anchors,
        solved: np.ndarray,
    ) -> kernels.Clusters:
        """Faces, border and seam edges of each cluster, each once, weighted by its corners there."""
        corner_vertex = faces.ravel()
        corner = np.arange(len(corner_vertex))
        face_start, face, face_weight = sum_repeated(
            self.vertex_map[corner_vertex], corner // 3, quadric_scale[corner_vertex], self._vertex_count
        )
        half_edge = np.flatnonzero(constrained)
        weight = np.where(constrained[half_edge] == 1, CONSTRAINT_WEIGHT[1], CONSTRAINT_WEIGHT[2])
        ends = np.concatenate([half_edge, half_edge - half_edge % 3 + (half_edge + 1) % 3])
        border_start, border_half_edge, border_weight = sum_repeated(
            self.vertex_map[corner_vertex[ends]],
            np.concatenate([half_edge, half_edge]),
            np.concatenate([weight, weight]) * quadric_scale[corner_vertex[ends]],
            self._vertex_count,
        )
        clusters, device = kernels.Clusters(), self._device
        clusters.member_start = wp.array(anchors.start, device=device)
        clusters.member = wp.array(anchors.vertex, device=device)
        clusters.member_weight = wp.array(anchors.weight, device=device)
        clusters.face_start = wp.array(face_start, device=device)
        clusters.face = wp.array(faces[face], dtype=wp.vec3i, device=device)
        clusters.face_weight = wp.array(face_weight, device=device)
        clusters.border_start = wp.array(border_start, device=device)
        clusters.border = wp.array(border_half_edge, device=device)
        clusters.border_weight = wp.array(border_weight, device=device)
        clusters.solved = wp.array(solved, device=device)
        return clusters

    def _place_block(self, points: wp.array, frame_count: int) -> PlacedFrames:
        """Place blocks (V, B) of ``frame_count`` frames, in diagonals."""
        device, block_count = self._device, points.shape[1]
        kernel = kernels.place_vertices[width_of(points)]
        out = wp.empty((self._vertex_count, block_count), dtype=points.dtype, device=device)
        normal = wp.empty_like(out)

        def place(part: slice) -> None:
            wp.launch(
                kernel,
                dim=(part.stop - part.start, block_count),
                inputs=[points, self._corner_vertex, self._clusters, self._settings.epsilon, part.start],
                outputs=[out, normal],
                device=device,
            )

        launch_parts(kernel, place, self._vertex_count, device)
        return PlacedFrames(unpack_frames(out, frame_count), unpack_frames(normal, frame_count))

    def place_all(self, mesh: AnimatedMesh, progress: Callable[[int], None] | None = None) -> PlacedFrames:
        """Place all frames of the mesh, block by block; ``progress`` is called with the number of frames done."""
        shape = (mesh.frame_count, self._vertex_count, 3)
        placed = PlacedFrames(np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.float32))
        for block in frame_blocks(mesh.frame_count, mesh.vertex_count):
            points = pack_frames(mesh.points[block], self._device, centre=mesh.centre, scale=1 / mesh.diagonal)
            result = self._place_block(points, block.stop - block.start)
            placed.points[block], placed.normals[block] = result.points, result.normals
            if progress:
                progress(block.stop)
        return placed

    def count_flips(self, placed: PlacedFrames) -> np.ndarray:
        """Faces of each frame that face away from the input, (F,) int32."""
        flips = np.empty(len(placed.points), dtype=np.int32)
        for block in frame_blocks(len(flips), self._vertex_count):
            points, normals = (pack_frames(a[block], self._device) for a in (placed.points, placed.normals))
            count = wp.zeros(points.shape[1] * width_of(points), dtype=wp.int32, device=self._device)
            wp.launch(
                kernels.count_flips[width_of(points)],
                dim=(len(self.faces), points.shape[1]),
                inputs=[points, normals, self._out_corner_vertex],
                outputs=[count],
                device=self._device,
            )
            flips[block] = count.numpy()[: block.stop - block.start]
        return flips

    def original_points(self, mesh: AnimatedMesh, placed: PlacedFrames) -> np.ndarray:
        """The placed points in the caller's coordinates, (F, C, 3) float32."""
        points = mesh.original_points(placed.points)
        points[:, self._copied] = mesh.points[:, self._copied_from] + mesh.origin
        return points


def _heaviest(anchors: Anchors) -> np.ndarray:
    """Index into ``anchors.vertex`` of the member with the largest weight, per anchor (C,)."""
    cluster = np.repeat(np.arange(len(anchors.start) - 1), np.diff(anchors.start))
    largest = np.flatnonzero(anchors.weight == np.maximum.reduceat(anchors.weight, anchors.start[:-1])[cluster])
    return largest[np.unique(cluster[largest], return_index=True)[1]]


def _pin(anchors: Anchors, kept: np.ndarray, pinned: np.ndarray) -> Anchors:
    """Anchor each pinned vertex to itself alone, also where it is not among the nearest members of its cluster."""
    vertex, weight = anchors.vertex.copy(), anchors.weight.copy()
    cluster = np.repeat(np.arange(len(kept)), np.diff(anchors.start))
    weight[pinned[kept][cluster]] = 0.0
    first = anchors.start[:-1][pinned[kept]]
    vertex[first] = kept[pinned[kept]]
    weight[first] = 1.0
    return Anchors(anchors.start, vertex, weight)
