"""One mesh file as arrays, read through trimesh with its vertices and faces in the order of the file."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from warpqem.errors import MeshFileError
from warpqem.files.file_kinds import check_regular

__all__ = ["FileMesh", "has_shared_points", "read_mesh_file"]

# Vertices and faces stay as they are in the file: merged or sorted, those of two files would not be the same.
AS_THEY_ARE = {"process": False, "maintain_order": True}
# One mesh of an OBJ, whatever groups and materials there are in it; pictures are not looked at.
OF_FORMAT = {".obj": {"split_object": False, "group_material": False, "skip_materials": True}}
# Its triangles have corners of their own.
NO_SHARED_POINTS = (".stl",)
# Colours are bytes.
WHITE = 255.0


@dataclass(frozen=True)
class FileMesh:
    """What is in a mesh file.

    Attributes:
        points: float64, shape (V, 3).
        faces: int32, shape (N, 3); polygons come as triangles.
        uv: float32, shape (V, 2), texture coordinates; None without any.
        vertex_colors: float32, shape (V, 4), red, green, blue and alpha from 0 to 1, as numbers of the file; or None.
        face_colors: float32, shape (N, 4), the same of faces; or None.
    """

    points: npt.NDArray[np.float64]
    faces: npt.NDArray[np.int32]
    uv: npt.NDArray[np.float32] | None = None
    vertex_colors: npt.NDArray[np.float32] | None = None
    face_colors: npt.NDArray[np.float32] | None = None


def has_shared_points(path: str) -> bool:
    """Whether faces of a file of this kind share points."""
    return os.path.splitext(path)[1].lower() not in NO_SHARED_POINTS


def read_mesh_file(path: str) -> FileMesh:
    """Read a mesh file.

    Args:
        path: OBJ, PLY, STL, OFF, GLB, or what else trimesh reads. Several meshes in it become one, in their places.

    Raises:
        MeshFileError: the file is missing, cannot be read, or has no faces; the message names it.
    """
    check_regular(path, MeshFileError)
    if not os.path.isfile(path):
        raise MeshFileError(f"{path}: no such file")
    import trimesh

    options: dict[str, Any] = {**AS_THEY_ARE, **OF_FORMAT.get(os.path.splitext(path)[1].lower(), {})}
    try:
        found = trimesh.load(path, **options)
        if isinstance(found, trimesh.Scene):
            found = found.to_mesh() if hasattr(found, "to_mesh") else found.dump(concatenate=True)
    except MemoryError:
        raise
    except Exception as error:
        # Whatever its readers raise for a damaged file.
        reason = " ".join(str(error).split()) or type(error).__name__
        raise MeshFileError(f"{path}: cannot be read ({reason})") from error
    faces = np.asarray(getattr(found, "faces", ()))
    points = np.asarray(getattr(found, "vertices", ()), dtype=np.float64)
    if faces.ndim != 2 or faces.shape[1] != 3 or not len(faces) or points.ndim != 2:
        raise MeshFileError(f"{path}: no mesh, as there are no faces in it")
    if faces.min() < 0 or faces.max() >= len(points):
        corner = np.argwhere((faces < 0) | (faces >= len(points)))[0]
        raise MeshFileError(
            f"{path}: face {corner[0]} refers to vertex {faces[tuple(corner)]}, but there are {len(points)} vertices"
        )
    return FileMesh(points, np.ascontiguousarray(faces, dtype=np.int32), **_attributes(found, len(points), len(faces)))


def _attributes(mesh: Any, vertex_count: int, face_count: int) -> dict[str, npt.NDArray[np.float32]]:
    """Texture coordinates and colours, where there is one for each vertex or face."""
    visual = mesh.visual
    kind = getattr(visual, "kind", None)
    if kind == "texture":
        uv = getattr(visual, "uv", None)
        if uv is not None and np.shape(uv) == (vertex_count, 2):
            return {"uv": np.asarray(uv, dtype=np.float32)}
    for name, count in (("vertex", vertex_count), ("face", face_count)):
        if kind == name:
            colors = np.asarray(getattr(visual, f"{name}_colors"))
            if colors.shape == (count, 4):
                return {f"{name}_colors": (colors / WHITE).astype(np.float32)}
    return {}
