"""Frames of a mesh as mesh files, written through trimesh: OBJ, PLY, STL, OFF, GLB."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from warpqem.errors import MeshFileError, OptionError
from warpqem.files.temporary import replacing

if TYPE_CHECKING:
    import trimesh

__all__ = ["WrittenValues", "as_trimesh", "check_mesh_output", "write_frames"]

# Digits behind the point. They hold every bit of single precision of numbers above a tenth, so that points are written
# again. Normals are left out, as the programs that read the files make them.
TEXT: dict[str, Any] = {"digits": 9}
OPTIONS: Mapping[str, dict[str, Any]] = {
    "obj": {**TEXT, "include_normals": False},
    "off": TEXT,
    "ply": {"vertex_normal": False},
}
# Formats that hold a mesh in one file and need no further package.
WRITTEN = (".glb", ".obj", ".off", ".ply", ".stl")
# The points of an OBJ, the lines before those of an OFF, and digits that hold every bit of single precision.
OBJ_POINT = re.compile(r"^v \S+ \S+ \S+", re.MULTILINE)
OFF_HEADER = 2
POINT = "%.9g %.9g %.9g"
# Lines of an OBJ that name materials in another file, which is not written.
MATERIALS = re.compile(r"^(mtllib|usemtl).*\n", re.MULTILINE)
# Largest value of a colour in a file.
WHITE = 255.0


@dataclass(frozen=True)
class WrittenValues:
    """Values on the faces of a mesh that does not change its faces.

    Attributes:
        uv: Texture coordinates of each corner, (N, 3, 2); None without any.
        colors: Colours of each corner, (N, 3, 4) from 0 to 1; None without any.
        face_colors: Colours of each face, (N, 4); None without any.
    """

    uv: npt.NDArray[np.float32] | None = None
    colors: npt.NDArray[np.float32] | None = None
    face_colors: npt.NDArray[np.float32] | None = None


def check_mesh_output(output: str | os.PathLike[str], option: str = "output") -> None:
    """Refuse a name of no format that is written.

    Raises:
        OptionError: it is one.
    """
    if os.path.splitext(os.fspath(output))[1].lower() not in WRITTEN:
        raise OptionError(f"{option} {output}: the suffix must be one of {', '.join(WRITTEN)}, or that of a USD file")


def as_trimesh(
    points: npt.NDArray[np.floating], faces: npt.NDArray[np.int32], values: WrittenValues | None = None
) -> trimesh.Trimesh:
    """One frame as a ``trimesh.Trimesh``, its vertices and faces in their order.

    Args:
        points: (V, 3).
        faces: (N, 3).
        values: Texture coordinates and colours; where they have seams, vertices come once for each side.
    """
    return _Template(faces, len(points), values or WrittenValues()).mesh(points)


def write_frames(
    frames: Iterable[npt.NDArray[np.floating]],
    faces: npt.NDArray[np.int32],
    vertex_count: int,
    files: Sequence[str],
    values: WrittenValues | None = None,
) -> None:
    """Write each frame as a file, under a temporary name first.

    Args:
        frames: Points (V, 3) of each frame, one at a time.
        faces: (N, 3).
        vertex_count: V.
        files: The file of each frame; folders that are missing are made.
        values: See `as_trimesh`.

    Raises:
        MeshFileError: a file cannot be written.
    """
    template = _Template(faces, vertex_count, values or WrittenValues())
    for points, file in zip(frames, files, strict=True):
        target = Path(file).absolute()
        kind = target.suffix.lower()[1:]
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            mesh = template.mesh(points)
            data = mesh.export(file_type=kind, **OPTIONS.get(kind, {}))
            if isinstance(data, str):
                data = _with_all_digits(data, kind, mesh.vertices)
                data = (MATERIALS.sub("", data) if kind == "obj" else data).encode()
            with replacing(target) as temporary:
                temporary.write_bytes(data)
        except OSError as error:
            raise MeshFileError(f"{file}: cannot be written ({error.strerror or error})") from error


def _with_all_digits(text: str, kind: str, points: npt.NDArray[np.floating]) -> str:
    """The text of a file with its points as they are."""
    rows = [POINT % tuple(point) for point in points.tolist()]
    if kind == "obj":
        row = iter(rows)
        return OBJ_POINT.sub(lambda _: f"v {next(row)}", text)
    if kind == "off":
        lines = text.split("\n")
        lines[OFF_HEADER : OFF_HEADER + len(rows)] = rows
        return "\n".join(lines)
    return text


class _Template:
    """What the files of all frames share: faces, and vertices that are split where values have seams."""

    def __init__(self, faces: npt.NDArray[np.int32], vertex_count: int, values: WrittenValues) -> None:
        self._point_of: npt.NDArray[np.int64] | None = None
        self._faces, self._uv, self._colors = faces, None, None
        self._face_colors = values.face_colors
        keys = [part.reshape(faces.size, -1) for part in (values.uv, values.colors) if part is not None]
        if not keys:
            return
        corners = np.column_stack([faces.reshape(-1), *keys]).astype(np.float64)
        _, first, wedge = np.unique(corners, axis=0, return_index=True, return_inverse=True)
        self._point_of = faces.reshape(-1)[first].astype(np.int64)
        self._faces = wedge.reshape(-1, 3).astype(np.int32)
        if values.uv is not None:
            self._uv = values.uv.reshape(-1, 2)[first]
        if values.colors is not None:
            self._colors = values.colors.reshape(-1, 4)[first]

    def mesh(self, points: npt.NDArray[np.floating]) -> trimesh.Trimesh:
        import trimesh

        visual: Any = None
        if self._uv is not None:
            visual = trimesh.visual.TextureVisuals(uv=self._uv)
        elif self._colors is not None or self._face_colors is not None:
            visual = trimesh.visual.ColorVisuals(
                vertex_colors=_bytes(self._colors), face_colors=_bytes(self._face_colors)
            )
        used = points if self._point_of is None else points[self._point_of]
        return trimesh.Trimesh(used, self._faces, visual=visual, process=False)


def _bytes(colors: npt.NDArray[np.float32] | None) -> npt.NDArray[np.uint8] | None:
    return None if colors is None else np.clip(np.rint(colors * WHITE), 0, WHITE).astype(np.uint8)
