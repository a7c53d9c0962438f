"""Normal offsets of blend shapes, for meshes that get normals they had none of.

Without them the normals of the rest shape would stay on a surface that blend shapes bend.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from pxr import UsdGeom, UsdSkel, Vt

from warpqem.attribute_fit.material_normals import NormalFrames
from warpqem.mesh.smooth_normals import vertex_normals
from warpqem.usd.read.blend_shapes import ShapeData

__all__ = ["write_normal_offsets"]

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]
# Of unit vectors in single precision.
ROUNDING = 1e-6


class _RestNormals:
    """The normals of a mesh in its rest shape, which go along with its faces into other shapes."""

    def __init__(self, mesh: UsdGeom.Mesh, faces: Ints) -> None:
        """Read points and normals that are authored at the default time."""
        self.points: Floats = np.asarray(mesh.GetPointsAttr().Get(), dtype=np.float64)
        self._faces = faces
        authored: Floats = np.asarray(mesh.GetNormalsAttr().Get(), dtype=np.float64)
        if str(mesh.GetNormalsInterpolation()) == UsdGeom.Tokens.vertex:
            corners = authored[faces]
        else:
            corners = authored.reshape(*faces.shape, 3)
        # Corners of one vertex with one normal are one row.
        rows = np.column_stack([faces.ravel(), corners.reshape(-1, 3)])
        _, first, row = np.unique(rows, axis=0, return_index=True, return_inverse=True)
        self._row = row.reshape(faces.shape).astype(np.int32)
        self._vertex = faces.ravel()[first]
        self._normals = corners.reshape(-1, 3)[first]
        self._tilt = self._frames(self.points).tilt_of(self._normals)

    def _frames(self, points: Floats) -> NormalFrames:
        own = vertex_normals(points[self._vertex].astype(np.float32), self._row).astype(np.float64)
        return NormalFrames(points, self._faces, self._row, own)

    def offsets(self, moved: Floats) -> Floats:
        """What to add to the normals at the points (V', 3) where these are ``moved`` (V', 3); means over corners."""
        change = self._frames(moved).tilted(self._tilt) - self._normals
        count = np.bincount(self._vertex, minlength=len(moved))
        total = np.stack([np.bincount(self._vertex, axis, len(moved)) for axis in change.T], axis=1)
        found: Floats = total / np.maximum(count, 1)[:, None]
        return found


def write_normal_offsets(mesh: UsdGeom.Mesh, faces: Ints, shapes: Sequence[ShapeData]) -> None:
    """Give blend shapes without normal offsets those of a mesh whose new normals are authored.

    A normal keeps its tilt from the mean of its faces' normals, see `warpqem.attribute_fit.material_normals`.

    Args:
        mesh: The simplified mesh on the stage of the edits, with its points, normals and blend shapes.
        faces: int32, shape (N', 3).
        shapes: Its blend shapes on the input.
    """
    rest: _RestNormals | None = None
    for shape in shapes:
        if "offsets" not in shape.arrays or any(name.endswith("normalOffsets") for name in shape.arrays):
            continue
        rest = _RestNormals(mesh, faces) if rest is None else rest
        _write(UsdSkel.BlendShape(mesh.GetPrim().GetStage().GetPrimAtPath(shape.path)), rest)


def _write(shape: UsdSkel.BlendShape, rest: _RestNormals) -> None:
    index = np.asarray(shape.GetPointIndicesAttr().Get(), dtype=np.int64)
    inbetweens = [between for between in shape.GetInbetweens() if between.GetOffsets()]
    dense = []
    for points in (shape.GetOffsetsAttr().Get(), *(between.GetOffsets() for between in inbetweens)):
        offsets = np.zeros_like(rest.points)
        offsets[index] = np.asarray(points, dtype=np.float64)
        dense.append((offsets, rest.offsets(rest.points + offsets)))
    # Normals change beside the points that move, too.
    used = np.zeros(len(rest.points), dtype=bool)
    used[index] = True
    for _, normals in dense:
        used |= (np.abs(normals) > ROUNDING).any(axis=1)
    chosen = np.flatnonzero(used).astype(np.int32)
    shape.CreatePointIndicesAttr(Vt.IntArray.FromNumpy(chosen))
    for number, both in enumerate(dense):
        points, normals = (Vt.Vec3fArray.FromNumpy(values[chosen].astype(np.float32)) for values in both)
        if number == 0:
            shape.CreateOffsetsAttr(points)
            shape.CreateNormalOffsetsAttr(normals)
        else:
            inbetweens[number - 1].SetOffsets(points)
            inbetweens[number - 1].SetNormalOffsets(normals)
