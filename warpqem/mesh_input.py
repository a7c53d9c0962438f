"""Take points and faces from the caller, check them, and find the mesh's unit scale."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import warp as wp

from warpqem.errors import DegenerateMeshError, FaceIndexError, MeshShapeError, NonFinitePointError, OptionError
from warpqem.frame_blocks import frame_blocks
from warpqem.frame_stream import ArrayFrames, FrameSource, read_ahead

__all__ = [
    "AnimatedMesh",
    "FrameObserver",
    "MeshInput",
    "as_numpy",
    "as_vertex_values",
    "measure_mesh",
    "read_mesh",
]

FLOAT32_MAX = np.finfo(np.float32).max


@dataclass(frozen=True)
class MeshInput:
    """A mesh in motion as the caller gave it: faces checked, frames not read yet.

    Attributes:
        source: the frames, in the caller's coordinates.
        faces: (N, 3) int32 without faces that use a vertex twice.
        face_index: (N,) int32, the caller's index of each face.
        input_face_count: faces the caller gave.
        used: (V,) bool, vertices with a face.
    """

    source: FrameSource
    faces: np.ndarray
    face_index: np.ndarray
    input_face_count: int
    used: np.ndarray

    @property
    def frame_count(self) -> int:
        """Frames F."""
        return self.source.frame_count

    @property
    def vertex_count(self) -> int:
        """Input vertices V, unreferenced ones included."""
        return self.source.vertex_count


@dataclass(frozen=True)
class AnimatedMesh(MeshInput):
    """A mesh in motion whose frames have all been seen once.

    Attributes:
        origin: (3,) float64, taken off before the points are rounded to float32.
        centre: (3,) float32, middle of the bounding box of all frames, about ``origin``.
        diagonal: largest bounding-box diagonal of a frame, in the caller's units.
    """

    origin: np.ndarray
    centre: np.ndarray
    diagonal: float

    def points(self, frames: slice) -> np.ndarray:
        """Consecutive frames in the caller's coordinates minus ``origin``: (n, V, 3) float32, C-contiguous."""
        return _about(self.source.read(frames), self.origin)

    def chosen_points(self, frames: np.ndarray) -> np.ndarray:
        """The same of any frames, ascending."""
        chosen = np.empty((len(frames), self.vertex_count, 3), dtype=np.float32)
        for index, frame in enumerate(frames.tolist()):
            chosen[index] = self.points(slice(frame, frame + 1))[0]
        return chosen

    def to_unit(self, points: np.ndarray) -> np.ndarray:
        """Points about ``origin`` on a mesh of unit diagonal about ``centre``, float32."""
        unit = points - self.centre
        unit *= np.float32(1.0 / self.diagonal)
        return unit

    def original_points(self, unit: np.ndarray) -> np.ndarray:
        """Unit positions (..., 3) float32 back in the caller's coordinates, float32."""
        return (unit * self.diagonal + (self.centre + self.origin)).astype(np.float32)


class FrameObserver(Protocol):
    """Learns something from the frames while they are read for the first time."""

    def observe(self, frames: slice, points: np.ndarray) -> None:
        """See consecutive frames (n, V, 3) float32, about the mesh's origin; called in the order of the frames."""
        ...


def as_numpy(array: Any) -> np.ndarray:
    """A NumPy view or copy of a NumPy, Warp, array-interface or DLPack array, or a sequence."""
    if isinstance(array, np.ndarray):
        return array
    if isinstance(array, wp.array):
        return array.numpy()
    if hasattr(array, "__array_interface__"):
        return np.asarray(array)
    if hasattr(array, "__cuda_array_interface__"):
        return wp.array(array, copy=False).numpy()
    # Before __array__, which tensors on a GPU have only to raise from it.
    if hasattr(array, "__dlpack__"):
        return wp.from_dlpack(array).numpy()
    return np.asarray(array)


def _is_trimesh(value: Any) -> bool:
    """Whether it is a ``trimesh.Trimesh``, which nobody can hold without having imported trimesh.

    Importing it here would take longer than simplifying a small mesh.
    """
    trimesh = sys.modules.get("trimesh")
    return trimesh is not None and isinstance(value, trimesh.Trimesh)


def read_mesh(points: Any, faces: Any = None) -> MeshInput:
    """Check the shape of points (F, V, 3) or (V, 3), or a :class:`FrameSource`, and faces (N, 3).

    A ``trimesh.Trimesh`` as the only argument serves for both.

    Raises:
        MeshShapeError: wrong shape or dtype.
        FaceIndexError: index below 0 or not below V.
        DegenerateMeshError: no point, or no face with three different vertices.
    """
    if _is_trimesh(points):
        if faces is not None:
            raise OptionError("faces must not be given with a trimesh.Trimesh, which has its own")
        points, faces = points.vertices, points.faces
    elif faces is None:
        raise OptionError("faces (N, 3) are missing")
    source = _checked_source(points)
    given_faces = as_numpy(faces)
    f, face_index = _checked_faces(given_faces, source.vertex_count)
    used = np.zeros(source.vertex_count, dtype=bool)
    used[f] = True
    return MeshInput(source, f, face_index, len(given_faces), used)


def measure_mesh(
    mesh: MeshInput,
    observers: Sequence[FrameObserver] = (),
    block_frames: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> AnimatedMesh:
    """Read all frames once: check them, find the mesh's size, and let observers see them.

    Args:
        mesh: the mesh.
        observers: see every block after it was checked.
        block_frames: frames read at a time; None for as many as keep a device busy.
        progress: called with the number of frames seen.

    Raises:
        NonFinitePointError: NaN or infinite coordinate.
        DegenerateMeshError: no extent.
    """
    lows, highs, everywhere = [], [], bool(mesh.used.all())
    origin = np.zeros(3)
    broken: _Broken | None = None
    for frames, raw in read_ahead(mesh.source.read, frame_blocks(mesh.frame_count, mesh.vertex_count, block_frames)):
        low, high = _frame_bounds(raw)
        if not max(np.abs(low).max(), np.abs(high).max()) <= FLOAT32_MAX:
            broken = _Broken.add(broken, raw, frames.start)
        if broken is not None:
            # All frames are looked through, for the message to say how many points there are.
            continue
        if frames.start == 0 and raw.dtype != np.float32:
            # float64 coordinates far from the origin keep their precision when the offset goes first.
            origin = raw[0, mesh.used].mean(axis=0)
        points = _about(raw, origin)
        if raw.dtype != np.float32 or not everywhere:
            # A vertex without a face has no say in the mesh's size.
            low, high = _frame_bounds(points if everywhere else points[:, mesh.used])
        lows.append(low)
        highs.append(high)
        for observer in observers:
            observer.observe(frames, points)
        if progress:
            progress(frames.stop)
    if broken is not None:
        raise broken.error()
    low, high = np.concatenate(lows), np.concatenate(highs)
    diagonal = float(np.linalg.norm(high.astype(np.float64) - low, axis=1).max())
    if not 0.0 < diagonal < np.inf:
        raise DegenerateMeshError(f"the mesh has no extent: its bounding-box diagonal is {diagonal:g} in every frame")
    if not 1.0 / FLOAT32_MAX < diagonal < FLOAT32_MAX:
        raise DegenerateMeshError(f"the bounding-box diagonal, {diagonal:g}, cannot be scaled to 1 in single precision")
    centre = ((low.min(axis=0).astype(np.float64) + high.max(axis=0)) / 2).astype(np.float32)
    return AnimatedMesh(
        mesh.source, mesh.faces, mesh.face_index, mesh.input_face_count, mesh.used, origin, centre, diagonal
    )


def _about(points: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Points minus ``origin`` as float32; float32 points have none."""
    return np.ascontiguousarray(points if points.dtype == np.float32 else points - origin, dtype=np.float32)


def _checked_source(points: Any) -> FrameSource:
    if not isinstance(points, FrameSource):
        return ArrayFrames(_checked_points(as_numpy(points)))
    if points.frame_count < 1 or points.vertex_count < 1:
        raise DegenerateMeshError(f"points are empty: {points.frame_count} frames of {points.vertex_count} vertices")
    if points.dtype not in (np.float32, np.float64):
        raise MeshShapeError(f"points must be float32 or float64, got a source of {points.dtype}")
    return points


def _checked_points(points: np.ndarray) -> np.ndarray:
    if points.dtype.kind not in "fiu":
        raise MeshShapeError(f"points must be real numbers, got dtype {points.dtype}")
    if points.ndim not in (2, 3) or points.shape[-1] != 3:
        raise MeshShapeError(f"points must have shape (F, V, 3) or (V, 3), got {points.shape}")
    if 0 in points.shape:
        raise DegenerateMeshError(f"points are empty: shape {points.shape}")
    if points.ndim == 2:
        points = points[None]
    return points if points.dtype == np.float32 else points.astype(np.float64)


def _checked_faces(faces: np.ndarray, vertex_count: int) -> tuple[np.ndarray, np.ndarray]:
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise MeshShapeError(f"faces must have shape (N, 3), got {faces.shape}")
    if faces.dtype.kind not in "iu":
        raise MeshShapeError(f"faces must be integers, got dtype {faces.dtype}")
    if len(faces) == 0:
        raise DegenerateMeshError("there are no faces")
    out_of_range = (faces < 0) | (faces >= vertex_count)
    if out_of_range.any():
        face, corner = np.argwhere(out_of_range)[0]
        raise FaceIndexError(
            f"face {face} corner {corner} refers to vertex {faces[face, corner]}, but there are {vertex_count} vertices"
        )
    faces = faces.astype(np.int32)
    proper = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    if not proper.any():
        raise DegenerateMeshError(f"none of the {len(faces)} faces has three different vertices")
    return np.ascontiguousarray(faces[proper]), np.flatnonzero(proper).astype(np.int32)


def _frame_bounds(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corner (F, 3) of each frame; NaN and infinity come through.

    Vertices are taken 64 at a time, so that NumPy reduces long contiguous rows instead of rows of three.
    """
    frame_count, vertex_count, _ = points.shape
    whole = vertex_count - vertex_count % 64
    rows = points[:, :whole].reshape(frame_count, -1, 192)
    rest = points[:, whole:]
    bounds = []
    for reduce in (np.min, np.max):
        parts = [reduce(rest, axis=1)] if whole < vertex_count else []
        if whole:
            parts.append(reduce(reduce(rows, axis=1).reshape(frame_count, 64, 3), axis=1))
        bounds.append(reduce(np.stack(parts), axis=0))
    return bounds[0], bounds[1]


@dataclass(frozen=True)
class _Broken:
    """The first point that is no point, and how many there are."""

    text: str
    count: int

    @classmethod
    def add(cls, before: _Broken | None, points: np.ndarray, first_frame: int) -> _Broken:
        bad = ~(np.abs(points) <= FLOAT32_MAX)
        count = int(bad.any(axis=2).sum())
        if before is not None:
            return cls(before.text, before.count + count)
        frame, vertex, axis = np.argwhere(bad)[0]
        where = f"vertex {vertex} in frame {first_frame + frame}"
        return cls(f"{where} has {'xyz'[axis]} = {points[frame, vertex, axis]}", count)

    def error(self) -> NonFinitePointError:
        return NonFinitePointError(f"point of {self.text} ({self.count} such points in all)")


def as_vertex_values(values: Any, name: str, vertex_count: int) -> np.ndarray:
    """Check one finite number per vertex, (V,) float32.

    Raises:
        MeshShapeError: another shape or dtype, or a value that is not finite.
    """
    array = as_numpy(values)
    if array.shape != (vertex_count,) or array.dtype.kind not in "fiub":
        raise MeshShapeError(
            f"{name} must be {vertex_count} numbers, one per vertex, got shape {array.shape} dtype {array.dtype}"
        )
    array = array.astype(np.float32)
    if not np.isfinite(array).all():
        vertex = int(np.flatnonzero(~np.isfinite(array))[0])
        raise MeshShapeError(f"{name} of vertex {vertex} is {array[vertex]}")
    return array
