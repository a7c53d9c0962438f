"""The input vertices that each vertex stands for, before the first collapse: itself alone."""

from __future__ import annotations

import numpy as np
import warp as wp

from warpqem.kernels.mesh_state import Members

__all__ = ["build_members"]


def build_members(faces: np.ndarray, key_position: wp.array) -> Members:
    """Lists of one member each, with its place and area in the first key frame.

    Args:
        faces: (N, 3) int32.
        key_position: (V, B) blocks of points, in diagonals.
    """
    device, vertex_count = key_position.device, len(key_position)
    points = np.ascontiguousarray(key_position[:, :1].numpy()[:, 0, :, 0])
    corner = points[faces]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) / 6
    members = Members()
    members.position = wp.array(points, dtype=wp.vec3, device=device)
    share = np.bincount(faces.ravel(), np.repeat(area, 3), vertex_count)
    members.area = wp.array(share.astype(np.float32), dtype=wp.float32, device=device)
    # No point of a triangle is further from its nearest corner than its longest edge times 3^-0.5, but of obtuse ones.
    edge_squared = ((corner - np.roll(corner, -1, axis=1)) ** 2).sum(axis=2).max(axis=1) / 3
    reach = np.zeros(vertex_count, dtype=np.float32)
    np.maximum.at(reach, faces.ravel(), np.repeat(edge_squared, 3))
    members.reach_squared = wp.array(reach, dtype=wp.float32, device=device)
    members.following = wp.full(vertex_count, -1, dtype=wp.int32, device=device)
    members.last = wp.array(np.arange(vertex_count, dtype=np.int32), dtype=wp.int32, device=device)
    return members
