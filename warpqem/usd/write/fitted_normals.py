"""Normals that a mesh had none of, fitted to the smooth shading of the input: subdivision surfaces, and poses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom, Vt

from warpqem.attribute_fit.material_normals import NormalFrames, tilt_between
from warpqem.attribute_fit.partners import Partners
from warpqem.attribute_fit.values import (
    NormalErrors,
    ValueLayout,
    fit_normals,
    normal_errors,
    normal_misfits,
    own_normals,
    split_normals,
)
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
# Part of the faces' own error that normals of polygons may have at most where a skin or blend shapes carry them.
# Samples are on hidden faces, too: pictures of seven skins got better below 0.73, and some worse from 0.79 on.
MAX_CARRIED_ERROR = 0.75
# How often the rest shape counts among the poses of a skin, beyond once: as half of them, as more and more of all.
MORE_REST = (0, 4, 16, 64)
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
        hard, turned = transfer.seams.hard, transfer.turned_faces[:, None]
        # Turned over where those of the output are.
        faces = np.where(turned, transfer.input_faces[:, ::-1], transfer.input_faces)
        corners = np.arange(faces.size).reshape(-1, 3)
        self._corner = np.where(turned, corners[:, ::-1], corners).ravel()
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
            return self._outward * self._plain.normals(pose).reshape(-1, 3)[self._corner]
        points = pose if self._vertex is None else pose[self._vertex]
        row = self._group.ravel()[self._corner]
        return self._outward * vertex_normals(points, self._group)[row].astype(np.float64)

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
            samples = self._transfer.input_samples(pose.points, pose.placed)
            layouts.append(ValueLayout(found, elements, self.corner_row, samples))
        return layouts

    def fit_tilts(self, poses: Sequence[NormalPose], layouts: Sequence[ValueLayout]) -> npt.NDArray[np.float64]:
        """The tilts (K, R, 3) of the output's normals in K poses, 0 where there is none; splits `corner_row`."""
        values = [unit_vectors(self.of_input(pose.points)) for pose in poses]
        starts = [self.of_faces(pose.placed) for pose in poses]
        missed = [normal_misfits(*given) for given in zip(layouts, values, starts, strict=True)]
        own = (own_normals(*given) for given in zip(layouts, missed, starts, strict=True))
        split, row = split_normals(self._transfer.faces, layouts[0], own)
        self.corner_row = split.corner_row
        tilts = []
        for layout, misfit, start, pose in zip(layouts, missed, starts, poses, strict=True):
            fitted = fit_normals(replace(layout, corner_row=self.corner_row), misfit, start[row])
            tilts.append(self.frames(pose.shaped).tilt_of(pose.unturned(fitted, self.row_vertex)))
        return np.stack(tilts)

    def errors(self, pose: NormalPose, layout: ValueLayout, tilt: npt.NDArray[np.float64]) -> NormalErrors:
        """How far normals of a tilt (R, 3) are from the input's in a pose."""
        normals = pose.turned(self.frames(pose.shaped).tilted(tilt), self.row_vertex)
        return normal_errors(layout, self.of_input(pose.points), normals[self.corner_row])[0]

    def kept_errors(self, pose: NormalPose, layout: ValueLayout) -> NormalErrors:
        """The same of normals by the output's own faces: as pictures show polygons, else smooth but at hard edges."""
        if self._plain is not None:
            own = self._outward * SmoothingGroups(self._transfer.faces, CREASE_ANGLE).normals(pose.placed)
        else:
            own = self.of_faces(pose.placed)[self.corner_row]
        return normal_errors(layout, self.of_input(pose.points), own)[0]

    def fits(
        self, poses: Sequence[NormalPose], layouts: Sequence[ValueLayout], tilts: npt.NDArray[np.float64]
    ) -> NormalErrors:
        """The errors of normals of tilts (K or 1, R, 3) over all K poses."""
        given = zip(poses, layouts, np.broadcast_to(tilts, (len(poses), *tilts.shape[1:])), strict=True)
        return NormalErrors.over_poses(self.errors(*one) for one in given)


def _carried(
    shading: _Shading,
    poses: Sequence[NormalPose],
    layouts: Sequence[ValueLayout],
    tilts: npt.NDArray[np.float64],
    kept: Sequence[NormalErrors],
    only_nearer: bool,
) -> npt.NDArray[np.float64] | None:
    """One tilt (1, R, 3) that the poses (K, R, 3) of a skin agree on, the first of which is the rest shape.

    That counts as often as it takes for the rest shape not to be further from the input's normals than it is with
    those of its faces. None with ``only_nearer`` where the mean over the poses is not enough below ``kept`` (K,).
    """
    mean = NormalErrors.over_poses(kept)

    def is_nearer(tilt: npt.NDArray[np.float64]) -> bool:
        return not only_nearer or shading.fits(poses, layouts, tilt).is_within(mean, MAX_CARRIED_ERROR)

    agreed = [unit_vectors(tilts.sum(axis=0) + more * tilts[0])[None] for more in MORE_REST]
    for tilt in [*agreed, tilts[:1]]:
        if shading.errors(poses[0], layouts[0], tilt[0]).is_within(kept[0]) and is_nearer(tilt):
            return tilt
    # Then what is seen in the poses decides.
    if only_nearer:
        return agreed[0] if is_nearer(agreed[0]) else None
    return tilts[:1]


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
    kept = [shading.kept_errors(*given) for given in zip(poses, layouts, strict=True)]
    tilts = shading.fit_tilts(poses, layouts)
    only_nearer = transfer.is_plain and transfer.only_nearer
    if poser is not None:
        agreed = _carried(shading, poses, layouts, tilts, kept, only_nearer)
        if agreed is None:
            return False
        tilts = agreed
    elif only_nearer and not shading.fits(poses, layouts, tilts).is_within(NormalErrors.over_poses(kept)):
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
