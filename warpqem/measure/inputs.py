"""Checks of the mesh sequences handed to the measurements, and their common scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from warpqem.errors import (
    DegenerateMeshError,
    FaceIndexError,
    MeshShapeError,
    NonFinitePointError,
    OptionError,
)

__all__ = ["MeshSequence", "check_faces", "check_same_frame_count", "check_sequence", "chosen_frames", "frame_scale"]


@dataclass(frozen=True)
class MeshSequence:
    """Triangle mesh with one topology and moving points.

    Attributes:
        points: (F, V, 3) float64.
        faces: (N, 3) int64.
        used: (U,) int64, ascending indices of the vertices that faces refer to.
    """

    points: npt.NDArray[np.float64]
    faces: npt.NDArray[np.int64]
    used: npt.NDArray[np.int64]


def check_faces(faces: npt.ArrayLike, name: str) -> npt.NDArray[np.int64]:
    """Faces as (N, 3) int64.

    Raises:
        MeshShapeError: not (N, 3) integers.
        DegenerateMeshError: no face.
        FaceIndexError: a negative vertex index.
    """
    array = np.asarray(faces)
    if array.ndim != 2 or array.shape[1] != 3 or not np.issubdtype(array.dtype, np.integer):
        raise MeshShapeError(f"{name} faces: expected (N, 3) integers, got shape {array.shape}, dtype {array.dtype}")
    if len(array) == 0:
        raise DegenerateMeshError(f"{name} faces: the mesh has no face")
    if array.min() < 0:
        face = int(np.argmax((array < 0).any(axis=1)))
        raise FaceIndexError(f"{name} faces: face {face} has a negative vertex index: {array[face].tolist()}")
    return array.astype(np.int64)


def check_sequence(points: npt.ArrayLike, faces: npt.ArrayLike, name: str) -> MeshSequence:
    """Mesh sequence with checked shapes, indices and values.

    Args:
        points: (F, V, 3) or (V, 3) numbers.
        faces: (N, 3) integers.
        name: what the messages call this mesh.

    Raises:
        MeshShapeError: an array has the wrong shape or dtype, or there is no frame.
        NonFinitePointError: a point is NaN or infinite.
        FaceIndexError: a face refers to a vertex that does not exist.
        DegenerateMeshError: no face.
    """
    array = np.asarray(points)
    shape = array.shape
    if array.ndim == 2:
        array = array[None]
    if array.ndim != 3 or array.shape[2] != 3 or array.shape[0] == 0 or array.dtype.kind not in "fiu":
        raise MeshShapeError(f"{name} points: expected (F, V, 3) or (V, 3) numbers, got {shape}, dtype {array.dtype}")
    array = array.astype(np.float64)
    finite = np.isfinite(array).all(axis=2)
    if not finite.all():
        frame, vertex = np.argwhere(~finite)[0]
        value = array[frame, vertex].tolist()
        raise NonFinitePointError(f"{name} points: vertex {vertex} in frame {frame} is not finite: {value}")
    face_array = check_faces(faces, name)
    if face_array.max() >= array.shape[1]:
        face = int(np.argmax((face_array >= array.shape[1]).any(axis=1)))
        raise FaceIndexError(
            f"{name} faces: face {face} is {face_array[face].tolist()}, the mesh has {array.shape[1]} vertices"
        )
    return MeshSequence(array, face_array, np.unique(face_array))


def check_same_frame_count(reference: MeshSequence, test: MeshSequence) -> None:
    """Raise MeshShapeError naming both counts where the two sequences differ in length."""
    if len(reference.points) != len(test.points):
        raise MeshShapeError(
            f"frame counts differ: the reference mesh has {len(reference.points)}, the test mesh {len(test.points)}"
        )


def chosen_frames(frames: int | Sequence[int] | None, frame_count: int) -> npt.NDArray[np.int64]:
    """Ascending frame indices: all for None, so many evenly spread ones for a number, else those listed.

    Raises:
        OptionError: a number below 1, an empty list, or a frame that does not exist.
    """
    if frames is None:
        return np.arange(frame_count)
    given: Any = np.asarray(frames)
    if given.dtype.kind not in "iu" or given.ndim > 1 or given.size == 0:
        raise OptionError(f"frames: expected None, a number or a list of frame indices, got {frames!r}")
    if given.ndim == 0:
        if given < 1:
            raise OptionError(f"frames: expected at least 1 frame, got {frames}")
        spread = np.linspace(0, frame_count - 1, min(int(given), frame_count))
        return spread.round().astype(np.int64)
    if given.min() < 0 or given.max() >= frame_count:
        raise OptionError(f"frames: {frames!r} names a frame outside 0..{frame_count - 1}")
    return np.unique(given).astype(np.int64)


def frame_scale(reference: MeshSequence) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Centres (F, 3) and diagonals (F,) of the bounding boxes of the vertices in use.

    Raises:
        DegenerateMeshError: a frame has no extent, so no percentage of its diagonal exists.
    """
    points = reference.points[:, reference.used]
    low, high = points.min(axis=1), points.max(axis=1)
    diagonal = np.linalg.norm(high - low, axis=1)
    if not (diagonal > 0).all():
        raise DegenerateMeshError(f"reference points: no extent in frame {int(np.argmin(diagonal))}")
    return (low + high) / 2, diagonal
