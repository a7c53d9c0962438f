"""Normals made from points, smooth but across hard edges: for subdivision surfaces with creases, and for poses.

A mesh that is no longer deformed by a skeleton has normals of a rest shape, which fit none of its poses.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom, Vt

from warpqem.mesh.smooth_normals import corner_groups, vertex_normals

__all__ = ["write_hard_edged_normals"]


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
