"""Quadrics of the present faces at any state between the input and what ordering left, for memoryless orders.

A memoryless quadric is that of the faces around a vertex as they are (Lindstrom & Turk 1998), so that it changes with
every collapse nearby and is no sum that could be recorded once. It is made anew from what is recorded: where the
vertices were, and which collapses there were. One-rings hold their corners in ascending order, and so do those built
here, so that the sums have the bits that decimation had.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
import warp as wp

from warpqem.decimation.adjacency import build_adjacency
from warpqem.decimation.decimate import DecimatedMesh
from warpqem.decimation.initial_quadrics import constraint_weights
from warpqem.decimation.recorded_launches import LaunchGroup, part_work, record_shared, run_once
from warpqem.kernels import memoryless_quadric as kernels
from warpqem.kernels.lanes import width_of
from warpqem.kernels.mesh_state import KEY_FRAMES, MeshState
from warpqem.kernels.topology import BORDER, SEAM
from warpqem.mesh.grouping import faces_where
from warpqem.mesh.seams import half_edge_ends, image_marks
from warpqem.runtime import new_arrays
from warpqem.runtime.ahead import done_ahead
from warpqem.runtime.cpu_threads import thread_count
from warpqem.runtime.device import device_traits
from warpqem.runtime.launches import Recorder

__all__ = ["MemorylessQuadrics"]


class MemorylessQuadrics:
    """Makes quadrics of the faces at a state of an ordering.

    Args:
        input_faces: (N, 3) int32, what was ordered.
        ordered: what that left.
    """

    def __init__(self, input_faces: np.ndarray, ordered: DecimatedMesh) -> None:
        self._input_faces, self._ordered = input_faces, ordered
        # Where each face is in the order that ordering had.
        self._place: Callable[[], np.ndarray] | None = None
        if ordered.face_order is not None:
            find = functools.cache(functools.partial(_places, ordered.face_order))
            self._place = done_ahead(find) if device_traits(str(ordered.position.device)).own_memory else find
        half_edge = np.flatnonzero(ordered.constrained)
        kind, ends = ordered.constrained[half_edge], half_edge_ends(input_faces, half_edge)
        self._seams = ends[(kind & 2) != 0]
        self._borders = np.unique(ends[(kind & 1) != 0])

    def fill(
        self, faces: np.ndarray, face_map: np.ndarray, root: np.ndarray, wanted: np.ndarray, scale: np.ndarray,
        position: wp.array, quadric: wp.array,
    ) -> None:  # fmt: skip
        """Put the quadrics of some vertices in place.

        Args:
            faces: (M, 3) int32 over the kept vertices, the faces that are left.
            face_map: (M,) int32 ascending, the input face that each of them was.
            root: (V,) int32, the vertex that each input vertex collapsed into.
            wanted: (n,) int32, rows of the vertices.
            scale: (n,) float32, what planes at each count.
            position: (V, B) points, rows of all vertices that are left.
            quadric: (V, B), where the rows are put.
        """
        ordered, device = self._ordered, position.device
        is_wanted = np.zeros(len(root), dtype=bool)
        is_wanted[wanted] = True
        # A quadric needs no faces but those at its vertex.
        near = faces_where(faces, lambda corner: is_wanted.take(ordered.row.take(corner)))
        corner_row = ordered.row.take(faces.take(near, axis=0))
        if self._place is not None:
            # As ordering had them, so that the adjacency lists corners in the same order.
            corner_row = corner_row[np.argsort(self._place().take(face_map[near]))]
        corner_vertex = corner_row.ravel().astype(np.int32, copy=False)
        flags = np.zeros(len(root), dtype=np.int32)
        borders, seams = (ordered.row[root[ends]] for ends in (self._borders, self._seams))
        flags[borders] = int(BORDER)
        flags[seams] |= int(SEAM)
        scales = np.ones(len(root), dtype=np.float32)
        scales[wanted] = scale
        state, frames = MeshState(), KEY_FRAMES[width_of(position)]()
        state.corner_vertex = wp.array(corner_vertex, device=device)
        state.adjacency = build_adjacency(state.corner_vertex, len(root)).lists
        state.vertex_flags = wp.array(flags, device=device)
        state.quadric_scale = wp.array(scales, device=device)
        state.seam = wp.array(image_marks(seams, corner_vertex.reshape(-1, 3), len(root)), device=device)
        frames.position, frames.quadric = position, quadric
        weights = kernels.LineWeights()
        # Both half-edges of each.
        of_kind = constraint_weights(len(self._seams) // 2, len(self._input_faces))
        weights.border, weights.seam = of_kind[1], of_kind[2]
        chosen, one = (
            new_arrays.uploaded(is_wanted, dtype=wp.int32, device=device),
            new_arrays.uploaded([1], dtype=wp.int32, device=device),
        )
        part_count = thread_count(str(device))

        def renew(recorder: Recorder, part: int) -> None:
            work = part_work(part, part_count, str(device))
            kernel = kernels.renew_quadrics[width_of(position)]
            record_shared(recorder, kernel, [state, frames, weights, chosen, one], work)

        run_once([LaunchGroup(renew, part_count)], str(device))


def _places(face_order: np.ndarray) -> np.ndarray:
    """(N,) int32, where each face is in an order (N,) of them."""
    place = np.empty_like(face_order)
    place[face_order] = np.arange(len(face_order), dtype=face_order.dtype)
    return place
