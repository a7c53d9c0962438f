"""Initial quadrics of every vertex in every key frame."""

from __future__ import annotations

import numpy as np
import warp as wp

from warpqem.decimation.adjacency import Adjacency
from warpqem.kernels import plane_quadrics as kernels
from warpqem.kernels.lanes import POINTS, QUADRIC, width_of
from warpqem.runtime.launches import launch
from warpqem.runtime.part_launches import corners_of, launch_in_parts, rows_of, starts_of

__all__ = ["CONSTRAINT_WEIGHT", "constraint_lists", "given_quadrics", "initial_quadrics"]

# A border edge of length l counts as a square of area l^2 standing on it: as much as the faces beside it. A seam edge
# counts a tenth: values that slide a little across the surface leave the shape as it is. On characters of a few hundred
# faces the whole cost 20 % more shape error, and the UV error was no lower.
CONSTRAINT_WEIGHT = {1: 1.0, 2: 0.1}


def constraint_lists(corner_vertex: np.ndarray, constrained: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Border and seam half-edges by vertex, each at both its ends.

    Args:
        corner_vertex: (3N,) int32.
        constrained: (3N,) int, non-zero at border and seam half-edges.

    Returns:
        ``vertex`` (B,), ``start`` (B+1,) and ``half_edge``: those of ``vertex[i]`` are
        ``half_edge[start[i]:start[i + 1]]``, ascending; all int32.
    """
    half_edge = np.flatnonzero(constrained)
    following = half_edge - half_edge % 3 + (half_edge + 1) % 3
    ends = np.concatenate([corner_vertex[half_edge], corner_vertex[following]])
    order = np.lexsort((np.concatenate([half_edge, half_edge]), ends))
    vertex, first = np.unique(ends[order], return_index=True)
    start = np.append(first, len(ends))
    entries = np.concatenate([half_edge, half_edge])[order]
    return vertex.astype(np.int32), start.astype(np.int32), entries.astype(np.int32)


def initial_quadrics(
    corner_vertex: wp.array, adjacency: Adjacency, constrained: np.ndarray, position: wp.array, quadric_scale: wp.array
) -> wp.array:
    """Area-weighted plane quadrics and border and seam planes about each vertex, times ``quadric_scale`` (V,).

    Args:
        corner_vertex: (3N,) int32.
        adjacency: corners of all vertices.
        constrained: (3N,) int32, 1 at border and 2 at seam half-edges.
        position: (V, B) blocks of points, in diagonals.
        quadric_scale: (V,) float32, multiplies a vertex's own quadric.

    Returns:
        (V, B) blocks of quadrics.
    """
    device = corner_vertex.device
    vertex_count, block_count = position.shape
    width = width_of(position)
    face_count = len(corner_vertex) // 3
    normal = wp.empty((face_count, block_count), dtype=POINTS[width], device=device)
    quadric = wp.empty((vertex_count, block_count), dtype=QUADRIC[width], device=device)
    launch_in_parts(
        kernels.weigh_face_normals[width],
        (face_count, block_count),
        inputs=[corners_of(corner_vertex), position],
        outputs=[rows_of(normal)],
        device=device,
    )
    launch_in_parts(
        kernels.gather_vertex_quadrics[width],
        (vertex_count, block_count),
        inputs=[starts_of(adjacency.start), adjacency.corner, normal, rows_of(quadric_scale)],
        outputs=[rows_of(quadric)],
        device=device,
    )
    corners = corner_vertex.numpy()
    for kind, weight in CONSTRAINT_WEIGHT.items():
        vertex, start, half_edge = constraint_lists(corners, constrained == kind)
        if not len(vertex):
            continue
        launch(
            kernels.add_border_planes[width],
            dim=(len(vertex), block_count),
            inputs=[
                wp.array(half_edge, device=device),
                wp.array(start, device=device),
                wp.array(vertex, device=device),
                corner_vertex,
                position,
                quadric_scale,
                weight,
            ],
            outputs=[quadric],
            device=device,
        )
    return quadric


def given_quadrics(matrices: np.ndarray, device: str) -> wp.array:
    """Quadrics (V, 1) of one key frame with these symmetric matrices (V, 3, 3), each with its least at the vertex."""
    values = np.zeros((len(matrices), 1, 10, 1), dtype=np.float32)
    values[:, 0, :6, 0] = matrices[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    return wp.array(values, dtype=QUADRIC[1], device=device)
