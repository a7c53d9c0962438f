"""Sequences of mesh files of a sphere that sways, and the mesh of a USD file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from pxr import Usd, UsdGeom

from tests.support.meshes import icosphere


def poses(frame_count: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Points (F, V, 3), float32, and faces of a sphere that sways."""
    points, faces = icosphere(2)
    moved = np.repeat(np.asarray(points, dtype=np.float32)[None], frame_count, axis=0)
    for frame in range(frame_count):
        moved[frame, :, 0] += np.float32(0.3) * np.sin(moved[frame, :, 2] + np.float32(frame))
    return moved, np.asarray(faces, dtype=np.int32)


def write_files(folder: Path, suffix: str, points: np.ndarray, faces: np.ndarray, name: str = "ball-{}") -> list[Path]:
    """A file for each frame, numbered from 8 so that names and numbers sort in different orders."""
    folder.mkdir(exist_ok=True)
    files = []
    for frame, pose in enumerate(points, start=8):
        files.append(folder / (name.format(frame) + suffix))
        options = {"digits": 9} if suffix == ".obj" else {}
        trimesh.Trimesh(pose, faces, process=False).export(files[-1], **options)
    return files


def usd_mesh(path: Path) -> tuple[Usd.Stage, UsdGeom.Mesh]:
    stage = Usd.Stage.Open(str(path))
    [mesh] = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
    return stage, UsdGeom.Mesh(mesh)


def usd_frames(path: Path) -> tuple[np.ndarray, np.ndarray, list[float]]:
    """Points of all frames, faces, and time codes of the only mesh of a file."""
    stage, mesh = usd_mesh(path)
    times = mesh.GetPointsAttr().GetTimeSamples()
    codes = times or [Usd.TimeCode.Default()]
    points = np.array([mesh.GetPointsAttr().Get(code) for code in codes])
    faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    del stage
    return points, faces, times
