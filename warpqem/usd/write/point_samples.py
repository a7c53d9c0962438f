"""Points, extents and normals of a simplified mesh, written a block of frames at a time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from pxr import Sdf, UsdGeom, Vt

from warpqem.errors import StageError
from warpqem.mesh.smooth_normals import vertex_normals
from warpqem.usd.write.smooth_normals import is_creased, is_shaded_by_subdivision

__all__ = ["PointSamples"]

Points = npt.NDArray[np.float32]


class PointSamples:
    """A `warpqem.FrameSink` that authors the points of a mesh, their extents, and normals where it is to be smooth.

    A mesh is to be smooth if it was so by subdivision alone. `shaded_later` is true of one whose normals are written
    afterwards: when it is known where its creases are, or what they are fitted to; see `warpqem.usd.write.hard_edges`
    and `warpqem.usd.write.fitted_normals`.

    Args:
        mesh: The mesh on the stage of the edits, before any.
        times: Time code of each frame, None for one frame at the default time.
        saved: Called with the bytes of each sample that was authored.
        with_normals: False if no normals are to be written here.
    """

    def __init__(
        self, mesh: UsdGeom.Mesh, times: list[float] | None, saved: Callable[[int], None], with_normals: bool = True
    ) -> None:
        self._mesh, self._times, self._saved = mesh, times, saved
        self._path = mesh.GetPath()
        self._layer: Sdf.Layer = mesh.GetPrim().GetStage().GetEditTarget().GetLayer()
        # A stale default value of a weaker layer is replaced by the first frame.
        self._hides_default = {
            "points": mesh.GetPointsAttr().Get() is not None,
            "extent": mesh.GetExtentAttr().Get() is not None,
            "normals": False,
        }
        self._left_handed = mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded
        shaded = is_shaded_by_subdivision(mesh)
        self.shaded_later: bool = shaded and (is_creased(mesh) or not with_normals)
        self.smooth: bool = shaded and not self.shaded_later
        self._outward = np.empty((0, 3), dtype=np.int32)

    def begin(self, frame_count: int, vertex_count: int, faces: npt.NDArray[np.int32]) -> None:
        """Create the attributes.

        Raises:
            StageError: a face refers to a point that does not exist.
        """
        if faces.min() < 0 or faces.max() >= vertex_count:
            raise StageError(
                f"{self._path}.faceVertexIndices: {faces.min()} to {faces.max()} for {vertex_count} points"
            )
        self._outward = faces[:, ::-1] if self._left_handed else faces
        self._mesh.CreatePointsAttr()
        self._mesh.CreateExtentAttr()
        if self.smooth:
            self._mesh.CreateNormalsAttr()
            self._mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)

    def write(self, frames: slice, points: Points) -> None:
        """Author consecutive frames.

        Raises:
            StageError: a point is not finite: a file is read by others, who would trip over it.
        """
        bad = ~np.isfinite(points).all(axis=2)
        if bad.any():
            frame, vertex = np.argwhere(bad)[0]
            name = "default" if self._times is None else f"{self._times[frames.start + frame]:g}"
            value = points[frame, vertex].tolist()
            raise StageError(
                f"{self._path}.points: the simplified point {vertex} at time {name} is {value} "
                f"({int(bad.sum())} such points)"
            )
        for index, pose in enumerate(points, start=frames.start):
            self._author("points", index, pose)
            self._author("extent", index, np.stack([pose.min(axis=0), pose.max(axis=0)]))
            if self.smooth:
                self._author("normals", index, vertex_normals(pose, self._outward))

    def _author(self, name: str, frame: int, array: Points) -> None:
        path, value = self._path.AppendProperty(name), Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(array))
        if self._times is None or (frame == 0 and self._hides_default[name]):
            self._layer.GetAttributeAtPath(path).default = value
        if self._times is not None:
            self._layer.SetTimeSample(path, self._times[frame], value)
        self._saved(array.nbytes)

    def discard(self) -> None:
        """Take back what was authored."""
        spec = self._layer.GetPrimAtPath(self._path)
        if spec is None:
            return
        for name in self._hides_default:
            attribute = self._layer.GetAttributeAtPath(self._path.AppendProperty(name))
            if attribute:
                spec.RemoveProperty(attribute)
        self._layer.ScheduleRemoveIfInert(spec)
