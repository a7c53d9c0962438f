"""The input vertices that each vertex stands for, before the first collapse: itself alone."""

from __future__ import annotations

import warp as wp

from warpqem.decimation.adjacency import Adjacency
from warpqem.kernels import initial_members as kernels
from warpqem.kernels.lanes import width_of
from warpqem.kernels.mesh_state import Members
from warpqem.runtime import new_arrays
from warpqem.runtime.launches import launch
from warpqem.runtime.part_launches import FIRST_ITEM, corners_of, launch_in_parts, rows_of

__all__ = ["build_members"]


def build_members(corner_vertex: wp.array, adjacency: Adjacency, key_position: wp.array, key_count: int) -> Members:
    """Lists of one member each, with its size in the key frames.

    Args:
        corner_vertex: (3N,) int32.
        adjacency: corners of all vertices.
        key_position: (V, B) blocks of points, in diagonals.
        key_count: key frames K in these.
    """
    device, vertex_count = key_position.device, len(key_position)
    members = Members()
    shape = (2, vertex_count)
    members.area, members.reach_squared = (new_arrays.empty(shape, dtype=wp.float32, device=device) for _ in range(2))
    members.first_point = new_arrays.empty(vertex_count, dtype=wp.vec3, device=device)
    members.following, members.last = (new_arrays.empty(vertex_count, dtype=wp.int32, device=device) for _ in range(2))
    launch(kernels.begin_members, vertex_count, [], [members], device=device)
    face_count = len(corner_vertex) // 3
    size = new_arrays.empty((face_count, 2), dtype=wp.float64, device=device)
    longest = new_arrays.empty((face_count, 2), dtype=wp.float32, device=device)
    of_faces = kernels.measure_faces[width_of(key_position)]
    outputs = [rows_of(size), rows_of(longest)]
    launch_in_parts(of_faces, face_count, [key_position, corners_of(corner_vertex)], outputs, device=device)
    inputs = [key_position, key_count, size, longest, adjacency.lists, FIRST_ITEM]
    measure = kernels.measure_members[width_of(key_position)]
    launch_in_parts(measure, vertex_count, inputs, [members], device=device)
    return members
