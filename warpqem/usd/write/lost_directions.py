"""Normals without a direction: renderers divide by their length, so that those of the new faces stand for them."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom

from warpqem.mesh.smooth_normals import vertex_normals
from warpqem.usd.read.value_arrays import Samples
from warpqem.usd.write.remove_properties import Dropped

__all__ = ["with_directions"]


def with_directions(
    mesh: UsdGeom.Mesh,
    faces: npt.NDArray[np.int32],
    name: str,
    samples: Samples,
    row: npt.NDArray[np.int32] | None,
    dropped: Dropped,
) -> Samples:
    """Normals of which none has the length zero.

    Args:
        mesh: The simplified mesh, with its points.
        faces: int32, shape (N', 3), its triangles.
        name: The attribute.
        samples: Its normals, (R, 3) in each.
        row: int32, shape (N', 3), which of them each corner has; None where each face has one.
        dropped: Takes how many had no direction in the first sample.
    """
    points = mesh.GetPointsAttr()
    outward = -1.0 if mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded else 1.0

    def lost_in(values: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
        return np.asarray(~values.any(axis=1), dtype=bool)

    def change(code: Usd.TimeCode) -> npt.NDArray[Any]:
        values = samples[code]
        lost = lost_in(values)
        if not lost.any():
            return values
        pose = np.asarray(points.Get(code) or points.Get(Usd.TimeCode.EarliestTime()), dtype=np.float32)
        if row is None:
            # Each face with vertices of its own: the first of them has its normal.
            own = (
                outward * vertex_normals(pose[faces.ravel()], np.arange(faces.size, dtype=np.int32).reshape(-1, 3))[::3]
            )
        else:
            vertex = np.zeros(len(values), dtype=np.int64)
            vertex[row] = faces
            own = outward * vertex_normals(pose[vertex], row)
        return np.where(lost[:, None], own, values).astype(values.dtype)

    first = samples[next(iter(samples))]
    if first.ndim != 2 or first.shape[1] != 3 or first.dtype.kind != "f":
        return samples
    count = int(lost_in(first).sum())
    if count:
        dropped.names.append(f"{count} of {len(first)} {name} of length 0: those of the new faces stand for them")
    return Samples(list(samples), change)
