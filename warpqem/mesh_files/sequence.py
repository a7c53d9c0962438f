"""A sequence of mesh files as the frames of one mesh: the same faces in every file, points read as they are needed."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from warpqem.arguments.array_input import FLOAT32_MAX
from warpqem.arguments.array_record import ArrayRecord
from warpqem.errors import MeshFileError
from warpqem.mesh_files.file_names import find_mesh_files, frame_numbers
from warpqem.mesh_files.reading import FileMesh, has_shared_points, read_mesh_file

__all__ = ["MeshSequence", "load", "scan"]

# Attributes that a mesh may have beside points and faces, as messages call them.
ATTRIBUTES = {"uv": "texture coordinates", "vertex_colors": "vertex colours", "face_colors": "face colours"}

Progress = Callable[[float, str], None]
Visit = Callable[[int, npt.NDArray[np.float64]], None]


@dataclass(frozen=True, eq=False, repr=False)
class MeshSequence(ArrayRecord):
    """Mesh files as the frames of one mesh: a :class:`warpqem.FrameSource` with faces.

    :func:`warpqem.simplify` takes it without ``faces``. Every block of frames is read from the files anew, so that a
    sequence of any length takes the memory of the frames that are at work.

    Attributes:
        files: the file of each frame.
        numbers: the number of each frame, from the names of the files, or counted from 1.
        faces: (N, 3) int32, the same in all files.
        vertex_count: vertices V.
        dtype: float32 where the points of the first file are such numbers, else float64.
        uv: (V, 2) float32 texture coordinates; None where not all files have the same.
        vertex_colors: (V, 4) float32, red, green, blue and alpha from 0 to 1; None likewise.
        face_colors: (N, 4) float32, the same of faces; None likewise.
        notes: what was found, or left out, one line each.
        corner_of: (V,) index of a point in a file for each vertex; None where they are the same.
    """

    files: list[str]
    numbers: list[int]
    faces: npt.NDArray[np.int32]
    vertex_count: int
    dtype: np.dtype[np.floating]
    uv: npt.NDArray[np.float32] | None = None
    vertex_colors: npt.NDArray[np.float32] | None = None
    face_colors: npt.NDArray[np.float32] | None = None
    notes: list[str] = field(default_factory=list)
    corner_of: npt.NDArray[np.int64] | None = None

    @property
    def frame_count(self) -> int:
        """Frames F."""
        return len(self.files)

    def read(self, frames: slice) -> npt.NDArray[np.floating]:
        """Points (n, V, 3) of consecutive frames.

        Raises:
            MeshFileError: a file cannot be read, or has another number of points than it had.
        """
        chosen = range(*frames.indices(self.frame_count))
        points = np.empty((len(chosen), self.vertex_count, 3), dtype=self.dtype)
        for place, frame in enumerate(chosen):
            found = read_mesh_file(self.files[frame]).points
            needed = self.vertex_count if self.corner_of is None else int(self.faces.size)
            if len(found) != needed:
                raise MeshFileError(f"{self.files[frame]}: {len(found)} points, where there were {needed} before")
            points[place] = found if self.corner_of is None else found[self.corner_of]
        return points


def load(
    pattern: str | os.PathLike[str] | Sequence[str | os.PathLike[str]], progress: Progress | None = None
) -> MeshSequence:
    """Load mesh files as the frames of one mesh, through trimesh.

    Every file is read once, to compare its faces with those of the first one; points are not kept. Files without shared
    points (STL) are welded: corners at exactly equal positions in every frame are one vertex.

    Args:
        pattern: a file (OBJ, PLY, STL, OFF, GLB, ...); a pattern such as "horse-*.ply" or "horse.####.ply", whose files
            come in natural order (2 before 10); or a list of files, in its order. One file is a clip of one frame.
        progress: called with the part done, 0 to 1, and the file.

    Returns:
        The frames and the faces, and texture coordinates and colours where all files have the same.

    Raises:
        MeshFileError: a file is missing, cannot be read, or its faces are not those of the first one.
        OptionError: a name is no mesh file's.

    Examples:
        >>> import numpy as np, trimesh, warpqem
        >>> ball = trimesh.creation.icosphere(subdivisions=3)
        >>> points = np.stack([ball.vertices * (1, 1, 1 + 0.2 * step) for step in range(4)])
        >>> warpqem.simplify(points, ball.faces, ratio=0.1).save("ball_##.ply")
        ['ball_01.ply', 'ball_02.ply', 'ball_03.ply', 'ball_04.ply']
        >>> clip = warpqem.load("ball_*.ply")
        >>> clip.frame_count, len(clip.faces)
        (4, 128)
    """
    return scan(find_mesh_files(pattern), progress)


def scan(files: list[str], progress: Progress | None = None, visit: Visit | None = None) -> MeshSequence:
    """Read all files once; see `load`.

    Args:
        files: The file of each frame.
        progress: Called with the part done and the file.
        visit: Called with each frame and the points (P, 3) of its file.

    Raises:
        MeshFileError: see `load`.
    """
    first = read_mesh_file(files[0])
    weld = None if all(map(has_shared_points, files)) else _Weld(len(first.points))
    attributes = {name: getattr(first, name) for name in ATTRIBUTES}
    notes: list[str] = []
    for frame, file in enumerate(files):
        if progress:
            progress(frame / len(files), f"reading {os.path.basename(file)}")
        mesh = first if frame == 0 else read_mesh_file(file)
        _check_same(mesh, first, file, files[0])
        _check_finite(mesh.points, file)
        notes += _keep_common(attributes, mesh, file, files[0])
        if weld is not None:
            weld.see(mesh.points)
        if visit:
            visit(frame, mesh.points)
    single = np.array_equal(first.points, first.points.astype(np.float32))
    dtype: np.dtype[np.floating] = np.dtype(np.float32 if single else np.float64)
    numbers = frame_numbers(files)
    if weld is None:
        return MeshSequence(files, numbers, first.faces, len(first.points), dtype, **attributes, notes=notes)
    vertex, corner = weld.vertices()
    notes.append(f"{len(vertex)} corners without shared points are welded to {len(corner)} vertices")
    if attributes["vertex_colors"] is not None:
        attributes["vertex_colors"] = attributes["vertex_colors"][corner]
    return MeshSequence(
        files, numbers, vertex[first.faces], len(corner), dtype, **attributes, notes=notes, corner_of=corner
    )


def _check_same(mesh: FileMesh, first: FileMesh, file: str, first_file: str) -> None:
    """Compare the topology of a file with that of the first one.

    Raises:
        MeshFileError: it is another; the message says what differs.
    """
    for what, found, expected in (
        ("faces", len(mesh.faces), len(first.faces)),
        ("points", len(mesh.points), len(first.points)),
    ):
        if found != expected:
            raise MeshFileError(f"{file}: {found} {what}, but {expected} in {first_file}; every frame needs the same")
    if not np.array_equal(mesh.faces, first.faces):
        face = int(np.flatnonzero((mesh.faces != first.faces).any(axis=1))[0])
        raise MeshFileError(
            f"{file}: face {face} is {mesh.faces[face].tolist()}, but {first.faces[face].tolist()} in {first_file}; "
            "every frame needs the same faces in the same order"
        )


def _check_finite(points: npt.NDArray[np.float64], file: str) -> None:
    """Refuse points that are no numbers in single precision.

    Raises:
        MeshFileError: one is none.
    """
    wrong = ~(np.abs(points) <= FLOAT32_MAX).all(axis=1)
    if wrong.any():
        point = int(np.flatnonzero(wrong)[0])
        raise MeshFileError(f"{file}: point {point} is {points[point].tolist()} ({int(wrong.sum())} such points)")


def _keep_common(attributes: dict[str, Any], mesh: FileMesh, file: str, first_file: str) -> list[str]:
    """Let go of attributes that a file does not have as the first one has them; returns a line for each."""
    notes = []
    for name, what in ATTRIBUTES.items():
        had, has = attributes[name], getattr(mesh, name)
        if had is not None and (has is None or not np.array_equal(had, has)):
            attributes[name] = None
            notes.append(f"{file}: {what} are not those of {first_file}, and are left out")
    return notes


class _Weld:
    """Which of some points lie together in every frame."""

    def __init__(self, point_count: int) -> None:
        self._label = np.zeros(point_count, dtype=np.int64)
        self._first = np.zeros(1, dtype=np.int64)

    def see(self, points: npt.NDArray[np.float64]) -> None:
        """Part points that do not lie together in a frame."""
        if np.array_equal(points[self._first][self._label], points):
            return
        # Zero has two signs, which are one position.
        keys = np.column_stack([self._label, (points + 0.0).view(np.int64)])
        _, first, label = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        # Counted by where they are used first, so that vertices are in the order of the file.
        order = np.argsort(first)
        rank = np.empty_like(order)
        rank[order] = np.arange(len(order))
        self._first, self._label = first[order], rank[label.reshape(-1)]

    def vertices(self) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int64]]:
        """The vertex of each point, and a point of each vertex."""
        return self._label.astype(np.int32), self._first
