"""Take points and faces from the caller, check them, and find the mesh's unit scale."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from warpqem.errors import DegenerateMeshError, FaceIndexError, MeshShapeError, NonFinitePointError, OptionError

__all__ = ["AnimatedMesh", "as_numpy", "as_vertex_values", "read_mesh"]


@dataclass(frozen=True)
class AnimatedMesh:
    """A checked mesh in motion.

    Attributes:
        points: (F, V, 3) float32, the caller's coordinates minus ``origin``.
        faces: (N, 3) int32 without faces that use a vertex twice.
        face_index: (N,) int32, the caller's index of each face.
        input_face_count: faces the caller gave.
        used: (V,) bool, vertices with a face.
        origin: (3,) float64, taken off before the points were rounded to float32.
        centre: (3,) float32, middle of the bounding box of all frames, about ``origin``.
        diagonal: largest bounding-box diagonal of a frame, in the caller's units.
    """

    points: np.ndarray
    faces: np.ndarray
    face_index: np.ndarray
    input_face_count: int
    used: np.ndarray
    origin: np.ndarray
    centre: np.ndarray
    diagonal: float

    @property
    def frame_count(self) -> int:
        """Frames F."""
        return len(self.points)

    @property
    def vertex_count(self) -> int:
        """Input vertices V, unreferenced ones included."""
        return self.points.shape[1]

    def unit_points(self, frames: slice | np.ndarray) -> np.ndarray:
        """The chosen frames on a mesh of unit diagonal about ``centre``: (B, V, 3) float32."""
        unit = self.points[frames] - self.centre
        unit *= np.float32(1.0 / self.diagonal)
        return unit

    def original_points(self, unit: np.ndarray) -> np.ndarray:
        """Unit positions (..., 3) float32 back in the caller's coordinates, float32."""
        return (unit * self.diagonal + (self.centre + self.origin)).astype(np.float32)


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


def read_mesh(points: Any, faces: Any = None) -> AnimatedMesh:
    """Check points (F, V, 3) or (V, 3) and faces (N, 3), or a ``trimesh.Trimesh`` as the only argument.

    Raises:
        MeshShapeError: wrong shape or dtype.
        NonFinitePointError: NaN or infinite coordinate.
        FaceIndexError: index below 0 or not below V.
        DegenerateMeshError: no point, no face with three different vertices, or no extent.
    """
    if _is_trimesh(points):
        if faces is not None:
            raise OptionError("faces must not be given with a trimesh.Trimesh, which has its own")
        points, faces = points.vertices, points.faces
    elif faces is None:
        raise OptionError("faces (N, 3) are missing")
    p = _checked_points(as_numpy(points))
    given_faces = as_numpy(faces)
    f, face_index = _checked_faces(given_faces, p.shape[1])
    used = np.zeros(p.shape[1], dtype=bool)
    used[f] = True
    low, high = _frame_bounds(p)
    if not max(np.abs(low).max(), np.abs(high).max()) <= np.finfo(np.float32).max:
        raise _non_finite(p)
    origin = np.zeros(3)
    if p.dtype != np.float32:
        # float64 coordinates far from the origin keep their precision when the offset goes first.
        origin = p[0, used].mean(axis=0)
        p = (p - origin).astype(np.float32)
    # A vertex without a face has no say in the mesh's size.
    low, high = _frame_bounds(p if used.all() else p[:, used])
    diagonal = float(np.linalg.norm(high.astype(np.float64) - low, axis=1).max())
    if not 0.0 < diagonal < np.inf:
        raise DegenerateMeshError(f"the mesh has no extent: its bounding-box diagonal is {diagonal:g} in every frame")
    centre = ((low.min(axis=0).astype(np.float64) + high.max(axis=0)) / 2).astype(np.float32)
    return AnimatedMesh(np.ascontiguousarray(p), f, face_index, len(given_faces), used, origin, centre, diagonal)


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


def _non_finite(points: np.ndarray) -> NonFinitePointError:
    bad = ~(np.abs(points) <= np.finfo(np.float32).max)
    frame, vertex, axis = np.argwhere(bad)[0]
    return NonFinitePointError(
        f"point of vertex {vertex} in frame {frame} has {'xyz'[axis]} = {points[frame, vertex, axis]} "
        f"({int(bad.any(axis=2).sum())} such points in all)"
    )


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
