"""Normals that a mesh had none of, fitted to the smooth shading of the input: subdivision surfaces, and poses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom, Vt

from warpqem.attribute_fit.material_normals import NormalFrames, tilt_between
from warpqem.attribute_fit.partners import Partners
from warpqem.attribute_fit.values import ValueLayout, fit_normals, normal_error, own_normals, split_normals
from warpqem.mesh.directions import unit_vectors
from warpqem.mesh.smooth_normals import SmoothingGroups, corner_groups, vertex_normals
from warpqem.picture.look import CREASE_ANGLE
from warpqem.usd.read.skeleton_poses import MeshPoser
from warpqem.usd.write.attribute_transfer import AttributeTransfer
from warpqem.usd.write.normal_poses import NormalPose, shown_poses, written_poses
from warpqem.usd.write.spread import spread

__all__ = ["smooth_input_normals", "write_fitted_normals"]

Points = npt.NDArray[np.float32]

# Poses that normals are fitted in. Between them they turn with the surface, which is nearly as good as a fit in every
# frame, and takes a fraction of the time.
MAX_POSES = 16
# Part of the faces' own error that normals of polygons may have at most where a skin carries them. Samples are on
# hidden faces, too: pictures of seven skins got better below 0.73, and some worse from 0.79 on.
MAX_CARRIED_ERROR = 0.75
# Poses of a skin besides its rest shape: one normal stands for all of them.
MAX_SHOWN_POSES = 8


class _Shading:
    """The smooth normals of the input, at the corners of its triangles, and those of the output's own faces.

    Attributes:
        corner_row: int32, shape (N', 3), which of R normals each corner of the output has.
    """

    def __init__(self, transfer: AttributeTransfer, outward: float) -> None:
        """``outward`` is -1 where triangles are clockwise seen from the front."""
        self._transfer, self._outward = transfer, outward
        faces, hard = transfer.input_faces, transfer.seams.hard
        # Polygons without normals are shaded as pictures show them. Where the output has an edge, too, is left to the
        # fits of its faces: what is sharp now is no line that simplification holds.
        self._plain = SmoothingGroups(faces, CREASE_ANGLE) if transfer.is_plain else None
        self._group = corner_groups(faces, hard).astype(np.int32) if len(hard) else faces
        _, corner = np.unique(self._group, return_index=True)
        self._vertex = faces.ravel()[corner] if len(hard) else None
        _, row = np.unique(transfer.sides(hard), return_inverse=True)
        self.corner_row = row.reshape(-1, 3).astype(np.int32)

    def of_input(self, pose: Points) -> npt.NDArray[np.float64]:
        """(3N, 3) in a pose of the input."""
        if self._plain is not None:
            return self._outward * self._plain.normals(pose).reshape(-1, 3)
        points = pose if self._vertex is None else pose[self._vertex]
        return self._outward * vertex_normals(points, self._group)[self._group].reshape(-1, 3).astype(np.float64)

    @property
    def row_vertex(self) -> npt.NDArray[np.int64]:
        """The vertex of the output that each of the R normals is at."""
        vertex = np.zeros(int(self.corner_row.max()) + 1, dtype=np.int64)
        vertex[self.corner_row] = self._transfer.faces
        return vertex

    def of_faces(self, placed: Points) -> npt.NDArray[np.float64]:
        """(R, 3) in a pose of the output."""
        return self._outward * vertex_normals(placed[self.row_vertex], self.corner_row).astype(np.float64)

    def frames(self, placed: Points) -> NormalFrames:
        """Of the R normals in a pose of the output."""
        return NormalFrames(placed, self._transfer.faces, self.corner_row, self.of_faces(placed))

    def layouts(self, poses: Sequence[NormalPose]) -> list[ValueLayout]:
        """Where normals stand, with the partners of samples in each pose: about where they are in the first."""
        elements = np.arange(self._group.size, dtype=np.int32).reshape(-1, 3)
        search = self._transfer.partner_search(self._transfer.seams.hard)
        first: Partners | None = None
        layouts = []
        for pose in poses:
            found = search.find(pose.points, pose.placed, first)
            first = found if first is None else first
            layouts.append(ValueLayout(found, elements, self.corner_row))
        return layouts

    def fit_tilts(self, poses: Sequence[NormalPose], layouts: Sequence[ValueLayout]) -> npt.NDArray[np.float64]:
        """The tilts (K, R, 3) of the output's normals in K poses, 0 where there is none; splits `corner_row`."""
        values = [self.of_input(pose.points) for pose in poses]
        starts = [self.of_faces(pose.placed) for pose in poses]
        own = [own_normals(*given) for given in zip(layouts, values, starts, strict=True)]
        split, row = split_normals(self._transfer.faces, layouts[0], own)
        self.corner_row = split.corner_row
        tilts = []
        for layout, value, start, pose in zip(layouts, values, starts, poses, strict=True):
            fitted = fit_normals(replace(layout, corner_row=self.corner_row), value, start[row])
            tilts.append(self.frames(pose.shaped).tilt_of(pose.unturned(fitted, self.row_vertex)))
        return np.stack(tilts)

    def are_nearer(
        self, poses: Sequence[NormalPose], layouts: Sequence[ValueLayout], tilts: npt.NDArray[np.float64]
    ) -> bool:
        """Whether normals of these tilts (K or 1, R, 3) are nearer to the input's over K poses than the faces' own.

        These are those that pictures show of polygons without normals, as of the input.
        """
        faces, fitted, plain = self._transfer.faces, 0.0, 0.0
        own = SmoothingGroups(faces, CREASE_ANGLE)
        for number, (pose, layout) in enumerate(zip(poses, layouts, strict=True)):
            values = self.of_input(pose.points)
            rows = self.frames(pose.shaped).tilted(tilts[number % len(tilts)])
            fitted += normal_error(layout, values, pose.turned(rows, self.row_vertex)[self.corner_row])
            plain += normal_error(layout, values, self._outward * own.normals(pose.placed))
        most = 1.0 if all(pose.turn is None for pose in poses) else MAX_CARRIED_ERROR
        return fitted < most * plain


def smooth_input_normals(transfer: AttributeTransfer, pose: Points, outward: float) -> npt.NDArray[np.float64]:
    """Normals (N, 3, 3) of the input's faces in a pose, smooth but across hard edges; ``outward`` as in `_Shading`."""
    return _Shading(transfer, outward).of_input(pose).reshape(-1, 3, 3)


def write_fitted_normals(
    mesh: UsdGeom.Mesh,
    transfer: AttributeTransfer,
    times: list[float] | None,
    saved: Callable[[int], None],
    poser: MeshPoser | None,
) -> bool:
    """Author normals of a mesh whose points are written, fitted to those that the input's surface has.

    Polygons that had none get none either where `AttributeTransfer.only_nearer` says so, and a skin would turn them
    further from the input's shading than that of their own faces is.

    Args:
        mesh: The simplified mesh on the stage of the edits, without normals.
        transfer: Where it gets its values from.
        times: Time code of each frame of points, None for one frame at the default time.
        saved: Called with the bytes of each sample that was authored.
        poser: What deforms the mesh; None for one that is written in its poses.

    Returns:
        Whether it got any.
    """
    outward = -1.0 if mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded else 1.0
    codes = [Usd.TimeCode.Default()] if times is None else [Usd.TimeCode(time) for time in times]
    shading = _Shading(transfer, outward)
    chosen = spread(range(len(codes)), MAX_POSES)
    poses = written_poses(mesh, transfer, codes, chosen)
    if poser is not None:
        poses += shown_poses(mesh, transfer, poser, spread(range(len(transfer.shown_codes)), MAX_SHOWN_POSES))
    layouts = shading.layouts(poses)
    tilts = shading.fit_tilts(poses, layouts)
    if poser is not None:
        # One that all poses agree on.
        tilts = unit_vectors(tilts.sum(axis=0))[None]
    if transfer.is_plain and transfer.only_nearer and not shading.are_nearer(poses, layouts, tilts):
        return False
    of_points = tilts.shape[1] == len(np.unique(transfer.faces))
    attribute = mesh.CreateNormalsAttr()
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex if of_points else UsdGeom.Tokens.faceVarying)
    for frame, code in enumerate(codes):
        points = np.asarray(mesh.GetPointsAttr().Get(code), dtype=np.float32)
        normals = shading.frames(points).tilted(tilt_between(np.array(chosen), tilts, frame))[shading.corner_row]
        if of_points:
            # +z at points that no face uses.
            at_points = np.tile([0.0, 0.0, 1.0], (len(points), 1))
            at_points[transfer.faces] = normals
            normals = at_points
        array = np.ascontiguousarray(normals.reshape(-1, 3), dtype=np.float32)
        attribute.Set(Vt.Vec3fArray.FromNumpy(array), code)
        saved(array.nbytes)
    return True
