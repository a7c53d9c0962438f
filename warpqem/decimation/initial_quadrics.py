"""Initial quadrics of every vertex in every key frame."""

from __future__ import annotations

import numpy as np
import warp as wp

from warpqem.decimation.adjacency import Adjacency
from warpqem.decimation.constrained_edges import ConstrainedEdges
from warpqem.kernels import plane_quadrics as kernels
from warpqem.kernels.lanes import POINTS, QUADRIC, width_of
from warpqem.runtime import new_arrays
from warpqem.runtime.launches import launch
from warpqem.runtime.part_launches import corners_of, launch_in_parts, rows_of, starts_of

__all__ = ["CONSTRAINT_WEIGHT", "constraint_weights", "given_quadrics", "initial_quadrics"]

# A border edge of length l counts as a square of area l^2 standing on it: as much as the faces beside it. A seam edge
# counts a fifth: values that slide a little across the surface leave the shape as it is. The UV error of characters is
# 5 % less than with a tenth, and their distance no more; a third costs 1 % of the distance for another 2 %.
CONSTRAINT_WEIGHT = {1: 1.0, 2: 0.2}
# Seams of more edges than this part of the faces count together as that many: with a whole fifth each, a lumberjack of
# 71 islands, on whom they are 0.38 of the faces, is 0.3 dB further off in pictures for 2 % less error of its texture.
# On other characters they are 0.03 to 0.24.
MAX_SEAM_SHARE = 0.15


def constraint_weights(seam_edges: int, face_count: int) -> dict[int, float]:
    """What planes weigh along the borders (1) and the seams (2) of a mesh of so many faces and edges of seams."""
    most = MAX_SEAM_SHARE * face_count
    return {1: CONSTRAINT_WEIGHT[1], 2: CONSTRAINT_WEIGHT[2] * (most / seam_edges if seam_edges > most else 1.0)}


def initial_quadrics(
    corner_vertex: wp.array, adjacency: Adjacency, edges: ConstrainedEdges, position: wp.array, quadric_scale: wp.array
) -> wp.array:
    """Area-weighted plane quadrics and border and seam planes about each vertex, times ``quadric_scale`` (V,).

    Args:
        corner_vertex: (3N,) int32.
        adjacency: corners of all vertices.
        edges: half-edges of borders and seams.
        position: (V, B) blocks of points, in diagonals.
        quadric_scale: (V,) float32, multiplies a vertex's own quadric.

    Returns:
        (V, B) blocks of quadrics.
    """
    device = corner_vertex.device
    vertex_count, block_count = position.shape
    width = width_of(position)
    face_count = len(corner_vertex) // 3
    normal = new_arrays.empty((face_count, block_count), dtype=POINTS[width], device=device)
    quadric = new_arrays.empty((vertex_count, block_count), dtype=QUADRIC[width], device=device)
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
    for kind, weight in constraint_weights(edges.seam_count, face_count).items():
        chosen = edges.of_kind(kind)
        if not len(chosen.half_edge):
            continue
        vertex, start, half_edge = chosen.lists()
        launch(
            kernels.add_border_planes[width],
            dim=(len(vertex), block_count),
            inputs=[
                *(new_arrays.uploaded(rows, dtype=wp.int32, device=device) for rows in (half_edge, start, vertex)),
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
    return new_arrays.uploaded(values, dtype=QUADRIC[1], device=device)
