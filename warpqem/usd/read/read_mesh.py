"""Read a mesh and its poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom, Vt

from warpqem.errors import StageError, VaryingTopologyError
from warpqem.usd.read.bake_times import bake_times
from warpqem.usd.read.declared_types import check_declared_types
from warpqem.usd.read.open_stage import world_scale
from warpqem.usd.read.pose_values import first_broken_value
from warpqem.usd.read.skeleton_poses import MeshPoser, StagePoses
from warpqem.usd.read.time_codes import FrameRange
from warpqem.usd.read.triangulation import TriangulatedFaces, read_topology
from warpqem.usd.read.visibility import seen_frames

__all__ = ["MeshLayout", "MeshSource", "PoseFrames", "StageMesh"]

# What the points of a mesh may be; a file can declare them as anything.
POINT_ARRAYS = (Vt.Vec3fArray, Vt.Vec3dArray, Vt.Vec3hArray)


@dataclass(frozen=True)
class MeshLayout:
    """A triangle mesh with one topology and a pose for each frame, which are not read yet.

    Attributes:
        path: Prim path.
        times: Time code of each frame; None for a mesh that does not move, read at the default time.
        faces: int32, shape (N, 3), indices into the points that a face uses, authored winding.
        used_points: int32, shape (V,), the authored point that each of these is.
        left_handed: True where the front of a face shows its corners clockwise.
        world_scale: World units per local unit at the first frame.
    """

    path: str
    times: list[float] | None
    faces: npt.NDArray[np.int32]
    used_points: npt.NDArray[np.int32]
    left_handed: bool
    world_scale: float

    @property
    def frame_count(self) -> int:
        """Number of poses."""
        return 1 if self.times is None else len(self.times)

    @property
    def right_handed_faces(self) -> npt.NDArray[np.int32]:
        """The faces in counter-clockwise winding, int32, shape (N, 3)."""
        return np.ascontiguousarray(self.faces[:, ::-1]) if self.left_handed else self.faces


@dataclass(frozen=True)
class StageMesh(MeshLayout):
    """The same with all its poses.

    Attributes:
        points: float32, shape (F, V, 3), local space; only points that a face uses.
    """

    points: npt.NDArray[np.float32]


@dataclass(frozen=True)
class PoseFrames:
    """Poses of a mesh as a `warpqem.FrameSource`, read from the stage each time.

    Attributes:
        source: The mesh.
        times: Time code of each frame; None for one frame at the default time.
        point: int32, shape (V,), the authored point that each vertex is.
    """

    source: MeshSource
    times: list[float] | None
    point: npt.NDArray[np.int32]

    @property
    def frame_count(self) -> int:
        """Number of poses."""
        return 1 if self.times is None else len(self.times)

    @property
    def vertex_count(self) -> int:
        """Number of vertices."""
        return len(self.point)

    @property
    def dtype(self) -> np.dtype[np.float32]:
        """Type of the points."""
        return np.dtype(np.float32)

    @cached_property
    def counted(self) -> npt.NDArray[np.bool_]:
        """Poses in which the mesh is visible, shape (F,)."""
        return np.ones(1, dtype=bool) if self.times is None else seen_frames(self.source.prim, self.times)

    def read(self, frames: slice) -> npt.NDArray[np.float32]:
        """Points of consecutive frames, float32, shape (n, V, 3), local space.

        Raises:
            StageError: see `MeshSource.points_at`.
        """
        times = [None] if self.times is None else self.times
        chosen = times[frames]
        points = np.empty((len(chosen), len(self.point), 3), dtype=np.float32)
        for pose, time in zip(points, chosen, strict=True):
            np.take(self.source.points_at(time), self.point, axis=0, out=pose)
        return points


class MeshSource:
    """One mesh of a stage: its topology, checked on construction, and its points at any time."""

    def __init__(self, prim: Usd.Prim, poses: StagePoses) -> None:
        """Read the topology.

        Args:
            prim: A `UsdGeom.Mesh` prim.
            poses: The skin bindings of its stage.

        Raises:
            StageError: points or faces are missing, blocked, inconsistent or of another type than the schema's.
            VaryingTopologyError: the topology changes over time.
        """
        # A prim does not keep its stage alive.
        self._stage = prim.GetStage()
        self.prim = prim
        self.path = str(prim.GetPath())
        self.mesh = UsdGeom.Mesh(prim)
        check_declared_types(self.mesh)
        self.poser: MeshPoser | None = poses.poser(prim)
        self._points = self.mesh.GetPointsAttr()
        self.authored_times: list[float] = self._find_times()
        first = self._first_points()
        self.point_count = len(first)
        # Polygons are cut by the authored points of the first pose, the rest shape of a mesh with a skin.
        shape = np.array(first, dtype=np.float32).reshape(-1, 3) if isinstance(first, POINT_ARRAYS) else None
        self.topology: TriangulatedFaces = read_topology(self.mesh, self.point_count, shape)

    @property
    def has_skin_binding(self) -> bool:
        """True if a skeleton or blend shapes deform the mesh."""
        return self.poser is not None

    @property
    def left_handed(self) -> bool:
        """True if the authored orientation is leftHanded."""
        return bool(self.mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded)

    def element_count(self, interpolation: str) -> int | None:
        """Elements of an array of this interpolation; None for those without one per element."""
        counts = {
            UsdGeom.Tokens.vertex: self.point_count,
            UsdGeom.Tokens.varying: self.point_count,
            UsdGeom.Tokens.uniform: self.topology.polygon_count,
            UsdGeom.Tokens.faceVarying: self.topology.corner_count,
        }
        return counts.get(interpolation)

    def frame_times(self, frames: FrameRange | None = None, *, baked: bool = False) -> list[float] | None:
        """The time code of each frame, or None for a mesh that does not move.

        Args:
            frames: Which of them; None for all.
            baked: The poses are to be written as points: the times that `bake_times` adds between are frames, too.

        Raises:
            StageError: the mesh moves but has no sample inside `frames`.
        """
        if not self.authored_times:
            return None
        times = self.authored_times
        if baked and self.poser is not None:
            times = bake_times(self._stage, times)
        if frames is None:
            return times
        times = frames.select(times)
        if not times:
            raise StageError(
                f"{self.path}.points: no sample between the times {frames.start:g} and {frames.end:g} "
                f"(samples from {self.authored_times[0]:g} to {self.authored_times[-1]:g}); add a step to interpolate"
            )
        return times

    def points_at(self, time: float | None) -> npt.NDArray[np.float32]:
        """All authored points in one pose.

        Args:
            time: Time code, None for the default time.

        Returns:
            float32, shape (authored point count, 3), local space.

        Raises:
            StageError: the sample is blocked or not finite.
            VaryingTopologyError: it has another length than the first one.
        """
        code = Usd.TimeCode.Default() if time is None else Usd.TimeCode(time)
        name = "default" if time is None else f"{time:g}"
        value = self._points.Get(code)
        self._check_points(value, name)
        if len(value) != self.point_count:
            raise VaryingTopologyError(
                f"{self.path}.points: {len(value)} points at time {name}, {self.point_count} before; "
                "a mesh whose topology varies over time cannot be simplified"
            )
        # What is not finite is named below.
        with np.errstate(invalid="ignore", over="ignore"):
            points = self._posed(value, code)
        finite = np.isfinite(points).all(axis=1)
        if not finite.all():
            vertex = int(np.flatnonzero(~finite)[0])
            cause = None if self.poser is None else first_broken_value(self.poser, code)
            because = "" if cause is None else f", as {cause}"
            raise StageError(f"{self.path}.points: point {vertex} at time {name} is {points[vertex].tolist()}{because}")
        return points

    def layout(self, times: Sequence[float] | None) -> MeshLayout:
        """The mesh at `times` (None: one frame at the default time), without the points that no face uses."""
        used, corners = np.unique(self.topology.triangles, return_inverse=True)
        first = Usd.TimeCode.Default() if times is None else Usd.TimeCode(times[0])
        return MeshLayout(
            path=self.path,
            times=None if times is None else list(times),
            faces=corners.reshape(-1, 3).astype(np.int32),
            used_points=used.astype(np.int32),
            left_handed=self.left_handed,
            world_scale=world_scale(self.prim, first),
        )

    def read(self, times: Sequence[float] | None) -> StageMesh:
        """The same with all its poses.

        Raises:
            StageError: see `points_at`.
        """
        layout = self.layout(times)
        frames = PoseFrames(self, layout.times, layout.used_points)
        return StageMesh(**vars(layout), points=frames.read(slice(0, frames.frame_count)))

    def _posed(self, value: object, code: Usd.TimeCode) -> npt.NDArray[np.float32]:
        if self.poser is not None:
            return self.poser.pose(value, code)
        return np.array(value, dtype=np.float32).reshape(-1, 3)

    def _find_times(self) -> list[float]:
        times = set(self._points.GetTimeSamples())
        if self.poser is not None:
            times |= self.poser.times()
        return sorted(times)

    def _first_points(self) -> Any:
        first = Usd.TimeCode(self.authored_times[0]) if self.authored_times else Usd.TimeCode.Default()
        value = self._points.Get(first)
        self._check_points(value, f"{self.authored_times[0]:g}" if self.authored_times else "default")
        return value

    def _check_points(self, value: object, time: str) -> None:
        if value is None:
            raise StageError(f"{self.path}.points: no value at time {time} (missing or blocked)")
        if not isinstance(value, POINT_ARRAYS):
            raise StageError(f"{self.path}.points: {type(value).__name__} at time {time}, no array of points")
