"""One mesh made ready for simplification: its frames, its seams, and what deforms it."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Sdf

from warpqem.simplification import SimplifiedMesh
from warpqem.usd.blend_shapes import choose_targets
from warpqem.usd.carrier import Carrier
from warpqem.usd.frames import FrameRange
from warpqem.usd.mesh import MeshSource, StageMesh
from warpqem.usd.seams import MeshSeams, find_seams
from warpqem.usd.skin import Skin, read_skin
from warpqem.usd.weld import weld

__all__ = ["MeshJob", "ReadOptions"]


@dataclass(frozen=True)
class _Fit:
    """A scaling and a move that bring the rest shape to the size and place of the poses.

    The skeleton may work in other units than the mesh; frames of another size would count for more, or for nothing.
    """

    scale: float
    rest_centre: npt.NDArray[np.float64]
    pose_centre: npt.NDArray[np.float64]

    @classmethod
    def of(cls, rest: npt.NDArray[np.float32], poses: npt.NDArray[np.float32]) -> _Fit:
        extents = [np.ptp(points.astype(np.float64), axis=0) for points in (rest, poses[0])]
        sizes = [float(np.linalg.norm(extent)) for extent in extents]
        centres = [points.min(axis=0) + extent / 2 for points, extent in zip((rest, poses[0]), extents, strict=True)]
        return cls(sizes[1] / sizes[0] if min(sizes) > 0 else 1.0, centres[0], centres[1])

    def apply(self, points: npt.NDArray[np.floating]) -> npt.NDArray[np.float32]:
        return ((points - self.rest_centre) * self.scale + self.pose_centre).astype(np.float32)

    def undo(self, points: npt.NDArray[np.floating]) -> npt.NDArray[np.float32]:
        return ((points - self.pose_centre) / self.scale + self.rest_centre).astype(np.float32)


@dataclass(frozen=True)
class ReadOptions:
    """How meshes are read.

    Attributes:
        frames: Time codes to read; None for all authored ones.
        bake: Leave the skin aside.
        weld: Join points that differ in nothing that moves them.
        influences: Joints that move a new point at most; None for as many as move an old one.
    """

    frames: FrameRange | None = None
    bake: bool = False
    weld: bool = True
    influences: int | None = None


@dataclass(frozen=True)
class MeshJob:
    """One mesh made ready.

    Attributes:
        source: The mesh on the stage.
        mesh: Its triangles and poses.
        faces: int32, shape (N, 3), its triangles on welded vertices; those that welding closed name a vertex twice.
        seams: Its seams.
        skin: What goes on deforming it; None for poses as point samples.
        unskinned_because: Why a skin is there but cannot be taken over; None if it can, or there is none.
        frames: float32, shape (E + F, V, 3), welded vertices in use: first E that only say how the mesh is shaped, then
            the poses. These E are the rest shape of a mesh with a skin and its blend shapes at full weight, or
            example poses of one without.
        pose_start: E.
    """

    source: MeshSource
    mesh: StageMesh
    faces: npt.NDArray[np.int32]
    seams: MeshSeams
    skin: Skin | None
    unskinned_because: str | None
    frames: npt.NDArray[np.float32]
    pose_start: int
    _fit: _Fit | None

    @classmethod
    def prepare(
        cls,
        source: MeshSource,
        options: ReadOptions | None = None,
        *,
        shape_users: Counter[Sdf.Path] | None = None,
        examples: MeshSource | None = None,
    ) -> MeshJob:
        """Read a mesh.

        Args:
            source: The mesh.
            options: How to read it; None for the defaults.
            shape_users: How many meshes use each BlendShape prim of the stage; None if each has one.
            examples: The same mesh in example poses. They take the place of the poses of a mesh with a skin, and come
                before those of one without.

        Raises:
            StageError: a pose cannot be read.
        """
        options = options or ReadOptions()
        mesh = source.read(source.frame_times(options.frames))
        if not len(mesh.faces):
            return cls(source, mesh, mesh.faces, MeshSeams(), None, None, mesh.points, 0, None)
        skin, reason = None, None
        if not options.bake:
            skin, reason = read_skin(source, shape_users or Counter(), options.influences)
        shown = mesh.points[:0] if examples is None else examples.read(examples.frame_times()).points
        vertex_point, faces, kept = mesh.used_points, mesh.faces, np.arange(len(mesh.used_points))
        if options.weld:
            joined = weld(faces, [*shown, *_what_moves(mesh, skin)])
            kept, vertex = np.unique(joined, return_inverse=True)
            vertex_point, faces = vertex_point[kept], vertex.ravel().astype(np.int32)[faces]
        seams = find_seams(
            source,
            faces,
            welded=len(vertex_point) < len(mesh.used_points),
            # Normals of a rest shape fit no pose, so that they are dropped where poses are written.
            with_normals=skin is not None or not source.has_skin_binding,
        )
        poses, shown = mesh.points[:, kept], shown[:, kept]
        if skin is None:
            frames = np.concatenate([shown, poses])
            return cls(source, mesh, faces, seams, None, reason, frames, len(shown), None)
        poses = shown if len(shown) else poses
        rest = skin.rest_points[vertex_point]
        targets = [rest + offsets[vertex_point] for offsets in choose_targets(skin.shapes)]
        fit = _Fit.of(rest, poses)
        extra = fit.apply(np.stack([rest, *targets]))
        return cls(source, mesh, faces, seams, skin, None, np.concatenate([extra, poses]), len(extra), fit)

    def output_points(self, result: SimplifiedMesh) -> tuple[list[float] | None, npt.NDArray[np.float32]]:
        """Times and points to write: the rest shape of a mesh with a skin, else its poses."""
        if self._fit is None:
            return self.mesh.times, result.points[self.pose_start :]
        return None, self._fit.undo(result.points[:1])

    def carrier(self, result: SimplifiedMesh, device: str | None) -> Carrier:
        """Where the simplified mesh gets its values from."""
        return Carrier(self.source, self.faces, self.frames[0], result, self.seams, device)


def _what_moves(mesh: StageMesh, skin: Skin | None) -> list[npt.NDArray[Any]]:
    """Everything that points must agree in to be one vertex: (V, ...) each."""
    arrays: list[npt.NDArray[Any]] = list(mesh.points)
    if skin is None:
        return arrays
    arrays.append(skin.rest_points[mesh.used_points])
    for influences in skin.influences.values():
        arrays += [influences.joints[mesh.used_points], influences.weights[mesh.used_points]]
    for shape in skin.shapes:
        # Normal offsets are values on the surface; they do not move it.
        arrays += [
            array[mesh.used_points] for name, array in shape.arrays.items() if not name.endswith("normalOffsets")
        ]
    return arrays
