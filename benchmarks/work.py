"""What is simplified: points, faces and the face count asked for, from a generator, a scene or a USD file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.generated import moving_torus

__all__ = ["Work", "load_work", "quadruped_work", "save_work", "torus_work", "usd_work"]


@dataclass(frozen=True)
class Work:
    """One mesh in motion and how far to simplify it.

    Attributes:
        name: what the reports call it.
        points: (F, V, 3) float32.
        faces: (N, 3) int32.
        target_faces: faces asked for.
    """

    name: str
    points: NDArray[np.float32]
    faces: NDArray[np.int32]
    target_faces: int

    @property
    def size(self) -> str:
        """Frames, vertices and faces in words."""
        frames, vertices, _ = self.points.shape
        return f"{frames} frames, {vertices} vertices, {len(self.faces)} faces to {self.target_faces}"


def _target(faces: NDArray[np.int32], ratio: float) -> int:
    return max(1, round(ratio * len(faces)))


def torus_work(face_count: int, frame_count: int, ratio: float) -> Work:
    """The generated torus."""
    points, faces = moving_torus(face_count, frame_count)
    return Work(f"torus {len(faces)} x {frame_count}", points, faces, _target(faces, ratio))


def quadruped_work(face_count: int, frame_count: int, ratio: float) -> Work:
    """The procedural quadruped galloping (needs what the scene generators need)."""
    from scenes import quadruped

    scene = quadruped.build(face_count, frame_count)
    return Work(
        f"quadruped {len(scene.faces)} x {frame_count}", scene.baked(), scene.faces, _target(scene.faces, ratio)
    )


def usd_work(path: Path, ratio: float, prim: str | None = None, frame_count: int | None = None) -> Work:
    """A mesh of a USD file, the largest where no prim is named, its split points welded as ``warpqem simplify`` does.

    Raises:
        WarpqemError: the file or the mesh cannot be read.
    """
    from warpqem.usd.read.open_stage import find_meshes, open_stage
    from warpqem.usd.read.read_mesh import MeshSource
    from warpqem.usd.read.skeleton_poses import StagePoses
    from warpqem.usd.read.weld import weld

    stage = open_stage(path)
    poses = StagePoses(stage)
    sources = [MeshSource(p, poses) for p in find_meshes(stage, [prim] if prim else []).prims]
    source = max(sources, key=lambda s: len(s.topology.triangles))
    times = source.frame_times()
    mesh = source.read(times if times is None else times[:frame_count])
    used, corners = np.unique(weld(mesh.faces, mesh.points)[mesh.faces], return_inverse=True)
    faces = corners.reshape(-1, 3).astype(np.int32)
    return Work(f"{path.name} {mesh.path}", np.ascontiguousarray(mesh.points[:, used]), faces, _target(faces, ratio))


def save_work(work: Work, path: Path) -> None:
    """Write an ``.npz`` that :func:`load_work` reads."""
    np.savez(path, name=work.name, points=work.points, faces=work.faces, target_faces=work.target_faces)


def load_work(path: Path) -> Work:
    """Read what :func:`save_work` wrote."""
    with np.load(path) as stored:
        return Work(str(stored["name"]), stored["points"], stored["faces"], int(stored["target_faces"]))
