"""Normals that a mesh had none of, fitted to the smooth shading of the input: subdivision surfaces, and poses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom, Vt

from warpqem.attribute_fit.material_normals import NormalFrames, tilt_between
from warpqem.attribute_fit.values import ValueLayout, fit_normals, own_normals, split_normals
from warpqem.mesh.smooth_normals import corner_groups, vertex_normals
from warpqem.picture.look import CREASE_ANGLE
from warpqem.usd.write.attribute_transfer import AttributeTransfer
from warpqem.usd.write.fitted_values import spread

__all__ = ["smooth_input_normals", "write_fitted_normals"]

Points = npt.NDArray[np.float32]

# Poses that normals are fitted in. Between them they turn with the surface, which is nearly as good as a fit in every
# frame, and takes a fraction of the time.
MAX_POSES = 16


class _Shading:
    """The smooth normals of the input, at the corners of its triangles, and those of the output's own faces.

    Attributes:
        corner_row: int32, shape (N', 3), which of R normals each corner of the output has.
    """

    def __init__(self, transfer: AttributeTransfer, outward: float) -> None:
        """``outward`` is -1 where triangles are clockwise seen from the front."""
        self._transfer, self._outward = transfer, outward
        faces, self._hard = transfer.input_faces, transfer.seams.hard
        # Polygons without normals are shaded as pictures show them. Where the output has an edge, too, is left to the
        # fits of its faces: what is sharp now is no line that simplification holds.
        hard = np.concatenate([self._hard, transfer.sharp_edges(CREASE_ANGLE)])
        self._group = corner_groups(faces, hard).astype(np.int32) if len(hard) else faces
        _, corner = np.unique(self._group, return_index=True)
        self._vertex = faces.ravel()[corner] if len(hard) else None
        _, row = np.unique(transfer.sides(self._hard), return_inverse=True)
        self.corner_row = row.reshape(-1, 3).astype(np.int32)

    def layout(self, pose: Points, placed: Points) -> ValueLayout:
        """Where normals stand, with the partners of samples in this pose of both meshes."""
        elements = np.arange(self._group.size, dtype=np.int32).reshape(-1, 3)
        return ValueLayout(self._transfer.find_partners(self._hard, pose, placed), elements, self.corner_row)

    def of_input(self, pose: Points) -> npt.NDArray[np.float64]:
        """(3N, 3) in a pose of the input."""
        points = pose if self._vertex is None else pose[self._vertex]
        return self._outward * vertex_normals(points, self._group)[self._group].reshape(-1, 3).astype(np.float64)

    def of_faces(self, placed: Points) -> npt.NDArray[np.float64]:
        """(R, 3) in a pose of the output."""
        vertex = np.zeros(int(self.corner_row.max()) + 1, dtype=np.int64)
        vertex[self.corner_row] = self._transfer.faces
        return self._outward * vertex_normals(placed[vertex], self.corner_row).astype(np.float64)

    def frames(self, placed: Points) -> NormalFrames:
        """Of the R normals in a pose of the output."""
        return NormalFrames(placed, self._transfer.faces, self.corner_row, self.of_faces(placed))

    def fit_tilts(self, poses: Sequence[tuple[Points, Points]]) -> npt.NDArray[np.float64]:
        """The tilts (K, R, 3) of the output's normals in K poses of both meshes; splits `corner_row`."""
        layouts = [self.layout(*pose) for pose in poses]
        values = [self.of_input(pose) for pose, _ in poses]
        starts = [self.of_faces(placed) for _, placed in poses]
        own = [own_normals(*given) for given in zip(layouts, values, starts, strict=True)]
        split, row = split_normals(self._transfer.faces, layouts[0], own)
        self.corner_row = split.corner_row
        tilts = []
        for layout, value, start, (_, placed) in zip(layouts, values, starts, poses, strict=True):
            fitted = fit_normals(replace(layout, corner_row=self.corner_row), value, start[row])
            tilts.append(self.frames(placed).tilt_of(fitted))
        return np.stack(tilts)


def smooth_input_normals(transfer: AttributeTransfer, pose: Points, outward: float) -> npt.NDArray[np.float64]:
    """Normals (N, 3, 3) of the input's faces in a pose, smooth but across hard edges; ``outward`` as in `_Shading`."""
    return _Shading(transfer, outward).of_input(pose).reshape(-1, 3, 3)


def write_fitted_normals(
    mesh: UsdGeom.Mesh,
    transfer: AttributeTransfer,
    times: list[float] | None,
    saved: Callable[[int], None],
) -> None:
    """Author normals of a mesh whose points are written, fitted to those that the input's surface has.

    Args:
        mesh: The simplified mesh on the stage of the edits, without normals.
        transfer: Where it gets its values from.
        times: Time code of each frame of points, None for one frame at the default time.
        saved: Called with the bytes of each sample that was authored.
    """
    outward = -1.0 if mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded else 1.0
    codes = [Usd.TimeCode.Default()] if times is None else [Usd.TimeCode(time) for time in times]

    def placed(frame: int) -> Points:
        return np.asarray(mesh.GetPointsAttr().Get(codes[frame]), dtype=np.float32)

    shading = _Shading(transfer, outward)
    chosen = spread(range(len(codes)), MAX_POSES)
    tilts = shading.fit_tilts([(transfer.read_pose(frame), placed(frame)) for frame in chosen])
    of_points = tilts.shape[1] == len(np.unique(transfer.faces))
    attribute = mesh.CreateNormalsAttr()
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex if of_points else UsdGeom.Tokens.faceVarying)
    for frame, code in enumerate(codes):
        points = placed(frame)
        normals = shading.frames(points).tilted(tilt_between(np.array(chosen), tilts, frame))[shading.corner_row]
        if of_points:
            # +z at points that no face uses.
            at_points = np.tile([0.0, 0.0, 1.0], (len(points), 1))
            at_points[transfer.faces] = normals
            normals = at_points
        array = np.ascontiguousarray(normals.reshape(-1, 3), dtype=np.float32)
        attribute.Set(Vt.Vec3fArray.FromNumpy(array), code)
        saved(array.nbytes)
