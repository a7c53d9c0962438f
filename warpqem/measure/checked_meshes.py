"""Checks of the mesh sequences handed to the measurements, and their common scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from warpqem.arguments.array_input import as_numpy, real_array
from warpqem.arguments.number_input import shown
from warpqem.errors import DegenerateMeshError, MeshShapeError, OptionError
from warpqem.mesh.mesh_input import finite_points, read_faces, read_points

__all__ = ["CheckedMesh", "check_same_frame_count", "check_sequence", "chosen_frames", "frame_scale"]


@dataclass(frozen=True)
class CheckedMesh:
    """Triangle mesh with one topology and moving points.

    Attributes:
        points: (F, V, 3) float64.
        faces: (N, 3) int64.
        used: (U,) int64, ascending indices of the vertices that faces refer to.
    """

    points: npt.NDArray[np.float64]
    faces: npt.NDArray[np.int64]
    used: npt.NDArray[np.int64]


def check_sequence(points: npt.ArrayLike, faces: npt.ArrayLike, name: str) -> CheckedMesh:
    """Mesh sequence with checked shapes, indices and values.

    Args:
        points: (F, V, 3) or (V, 3) numbers.
        faces: (N, 3) integers.
        name: what the messages call this mesh.

    Raises:
        MeshShapeError: an array has the wrong shape or dtype, or there is no frame.
        NonFinitePointError: a point is NaN or infinite.
        FaceIndexError: a face refers to a vertex that does not exist.
        DegenerateMeshError: no point or no face.
    """
    given = real_array(points, f"{name} points", ("F", "V", 3), ("V", 3))
    if not len(given):
        raise MeshShapeError(f"{name} points: expected at least one frame, got shape {given.shape}")
    array = finite_points(read_points(given, f"{name} points"), f"{name} points:").astype(np.float64)
    face_array = read_faces(faces, f"{name} faces", array.shape[1]).astype(np.int64)
    return CheckedMesh(array, face_array, np.unique(face_array))


def check_same_frame_count(reference: CheckedMesh, test: CheckedMesh) -> None:
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
    what = f"frames: expected None, a number or a list of frame indices, got {shown(frames)}"
    try:
        given: Any = as_numpy(frames, "frames")
    except MeshShapeError as error:
        raise OptionError(f"{what}: {error}") from error
    if given.dtype.kind not in "iu" or given.ndim > 1 or given.size == 0:
        raise OptionError(what)
    if given.ndim == 0:
        if given < 1:
            raise OptionError(f"frames: expected at least 1 frame, got {frames}")
        spread = np.linspace(0, frame_count - 1, min(int(given), frame_count))
        return spread.round().astype(np.int64)
    if given.min() < 0 or given.max() >= frame_count:
        raise OptionError(f"frames: {frames!r} names a frame outside 0..{frame_count - 1}")
    return np.unique(given).astype(np.int64)


def frame_scale(reference: CheckedMesh) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
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
