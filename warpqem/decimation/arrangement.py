"""Large meshes rearranged so that neighbours lie close together in memory.

Collapsing edges is a walk from neighbour to neighbour. Where a mesh does not fit the caches and its vertices come in an
order that says nothing about where they are, most of the time goes into waiting for memory.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import warp as wp

from warpqem.kernels import arrangement as kernels
from warpqem.kernels.lanes import width_of
from warpqem.kernels.work import Work
from warpqem.runtime import new_arrays
from warpqem.runtime.device import device_traits
from warpqem.runtime.launches import launch
from warpqem.runtime.part_launches import corners_of, launch_in_parts, rows_of

__all__ = ["ARRANGED_FACES", "Arrangement", "arrange"]

# Meshes of at least so many faces are rearranged: below it, the rows of one or two blocks of key frames fit the cache.
ARRANGED_FACES = 40_000
# Vertices that a thread looks at for the box around all: threads wait for each other where they widen it.
VERTICES_PER_THREAD = 64


@dataclass(frozen=True)
class Arrangement:
    """Vertices along a space-filling curve, and faces by their first vertex on it.

    Attributes:
        vertex: (V,) int32 on the device, the input vertex at each place.
        place: (V,) int32 on the device, where each input vertex is.
        face: (N,) int32 on the device, the input face at each place. Its corners keep their order.
    """

    vertex: wp.array
    place: wp.array
    face: wp.array

    @cached_property
    def host_vertex(self) -> np.ndarray:
        """``vertex`` on the host."""
        return np.array(self.vertex.numpy())

    @cached_property
    def host_place(self) -> np.ndarray:
        """``place`` on the host."""
        return np.array(self.place.numpy())

    @cached_property
    def host_face(self) -> np.ndarray:
        """``face`` on the host."""
        return np.array(self.face.numpy())

    def rearrange_faces(self, corner_vertex: wp.array) -> wp.array:
        """Corners (3N,) int32 of the rearranged faces over the rearranged vertices."""
        rearranged, device = wp.empty_like(corner_vertex), corner_vertex.device
        inputs = [corner_vertex, self.place, rows_of(self.face)]
        launch_in_parts(kernels.rearrange_corners, len(self.face), inputs, [corners_of(rearranged)], device=device)
        return rearranged

    def rearrange_rows(self, rows: wp.array) -> wp.array:
        """Blocks of points (V, B) of the rearranged vertices."""
        rearranged = wp.empty_like(rows)
        inputs = [rows, rows_of(self.vertex)]
        kernel = kernels.gather_rows[width_of(rows)]
        launch_in_parts(kernel, rows.shape, inputs, [rows_of(rearranged)], device=rows.device)
        return rearranged

    def rearrange_vertices(self, values: wp.array) -> wp.array:
        """Values (V,) of the vertices, int32 or float32."""
        return _gather(values, self.vertex, 1)

    def rearrange_corners(self, values: wp.array) -> wp.array:
        """Values (3N,) of the corners or half-edges, int32 or float32."""
        return _gather(values, self.face, 3)

    def restore_half_edges(self, half_edge: np.ndarray) -> np.ndarray:
        """Half-edges or corners (M,) as the input numbers them."""
        return 3 * self.host_face[half_edge // 3] + half_edge % 3


def arrange(corner_vertex: wp.array, position: wp.array) -> Arrangement:
    """Sort by Morton code: the bits of a vertex's cell in x, y and z, interleaved.

    Args:
        corner_vertex: (3N,) int32.
        position: (V, B) blocks of points; the first frame counts.
    """
    device, vertex_count, face_count = position.device, len(position), len(corner_vertex) // 3
    width, bounds = width_of(position), kernels.Bounds()
    bounds.low, bounds.high = (new_arrays.full(3, end, dtype=wp.float32, device=device) for end in (np.inf, -np.inf))
    work = Work()
    work.part, work.part_count = 0, 1
    most = device_traits(str(device)).launch_threads
    work.thread_count = max(1, min(most, vertex_count // VERTICES_PER_THREAD))
    launch(kernels.find_bounds[width], work.thread_count, [position, work], [bounds], device=device)
    keys, items = _sorting_room(vertex_count, device)
    launch(kernels.key_vertices[width], vertex_count, [position, bounds], [keys, items], device=device)
    vertex = _sorted_items(keys, items, vertex_count, 3 * int(kernels.CELL_BITS))
    place = wp.empty_like(vertex)
    launch(kernels.invert_order, vertex_count, [vertex], [place], device=device)
    keys, items = _sorting_room(face_count, device)
    launch(kernels.key_faces, face_count, [corner_vertex, place], [keys, items], device=device)
    return Arrangement(vertex, place, _sorted_items(keys, items, face_count, vertex_count.bit_length()))


def _sorting_room(count: int, device: wp.DeviceLike) -> tuple[wp.array, wp.array]:
    """Keys and items: a sort works between the two halves."""
    keys, items = (new_arrays.empty(2 * count, dtype=wp.int32, device=device) for _ in range(2))
    return keys, items


def _sorted_items(keys: wp.array, items: wp.array, count: int, bits: int) -> wp.array:
    """(count,) int32, items by ascending key, equal ones in their order."""
    wp.utils.radix_sort_pairs(keys, items, count, 0, bits)
    return wp.clone(items[:count])


def _gather(values: wp.array, item: wp.array, per_item: int) -> wp.array:
    """Values of items in the order of ``item``, ``per_item`` each."""
    gathered = wp.empty_like(values)
    kernel = kernels.gather_integers if values.dtype is wp.int32 else kernels.gather_numbers
    source, target = (array.reshape((len(item), per_item)) for array in (values, gathered))
    launch_in_parts(kernel, (len(item), per_item), [source, rows_of(item)], [rows_of(target)], device=values.device)
    return gathered
