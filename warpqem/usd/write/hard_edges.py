"""Normals made from points, smooth but across hard edges: for subdivision surfaces with creases, and for poses.

A mesh that is no longer deformed by a skeleton has normals of a rest shape, which fit none of its poses.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom, Vt

from warpqem.mesh.components import lowest_members
from warpqem.mesh.edges import edge_key
from warpqem.mesh.mesh_input import is_proper
from warpqem.usd.write.smooth_normals import vertex_normals

__all__ = ["corner_groups", "write_hard_edged_normals"]


def corner_groups(faces: npt.NDArray[np.int32], hard: npt.NDArray[np.int32]) -> npt.NDArray[np.int64]:
    """Which corners of faces share a normal: those at one vertex that edges join without a hard one between them.

    Args:
        faces: int32, shape (N, 3).
        hard: int32, shape (S, 2), pairs of vertices; those that are no edges say nothing.

    Returns:
        int64, shape (N, 3), numbers from 0 on.
    """
    tail, head = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    count = int(faces.max()) + 1
    key = edge_key(tail, head, count)
    soft = ~np.isin(key, edge_key(hard[:, 0], hard[:, 1], count)) & np.repeat(is_proper(faces), 3)
    order = np.argsort(key, kind="stable")
    order = order[soft[order]]
    pair = np.flatnonzero(key[order[1:]] == key[order[:-1]])
    first, second = order[pair], order[pair + 1]
    # The corner after each one in its face, at the other end of the edge.
    after = np.arange(faces.size).reshape(-1, 3)[:, [1, 2, 0]].ravel()
    same = tail[first] == tail[second]
    joined = np.concatenate(
        [
            np.stack([first, np.where(same, second, after[second])], axis=1),
            np.stack([after[first], np.where(same, after[second], second)], axis=1),
        ]
    )
    _, group = np.unique(lowest_members(faces.size, joined), return_inverse=True)
    return group.reshape(faces.shape).astype(np.int64)


def write_hard_edged_normals(
    mesh: UsdGeom.Mesh,
    faces: npt.NDArray[np.int32],
    hard: npt.NDArray[np.int32],
    times: list[float] | None,
    saved: Callable[[int], None],
) -> None:
    """Author normals of a mesh whose points are written, for every corner, or for every point if no edge is hard.

    Args:
        mesh: The simplified mesh on the stage of the edits, without normals.
        faces: int32, shape (N, 3), in the winding of its orientation.
        hard: int32, shape (S, 2), the pairs of its points between which the input is hard.
        times: Time code of each frame of points, None for one frame at the default time.
        saved: Called with the bytes of each sample that was authored.
    """
    outward = faces[:, ::-1] if mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded else faces
    group = corner_groups(outward, hard)
    of_points = bool(group.max() + 1 == len(np.unique(outward)))
    _, corner = np.unique(group, return_index=True)
    vertex = outward.ravel()[corner]
    # In the order of the corners as they are written.
    written = group if outward is faces else group[:, ::-1]
    attribute = mesh.CreateNormalsAttr()
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex if of_points else UsdGeom.Tokens.faceVarying)
    for code in [Usd.TimeCode.Default()] if times is None else map(Usd.TimeCode, times):
        points = np.asarray(mesh.GetPointsAttr().Get(code), dtype=np.float32)
        if of_points:
            normals = vertex_normals(points, outward)
        else:
            normals = vertex_normals(points[vertex], group.astype(np.int32))[written.ravel()]
        attribute.Set(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(normals)), code)
        saved(normals.nbytes)
