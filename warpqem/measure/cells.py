"""Cells of a surface on the device: a mesh in several frames at once, or several meshes in one frame."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.kernels import surface_distance as kernels
from warpqem.kernels.near_faces import CellTable, Surface
from warpqem.measure.winding import Winding, read_winding
from warpqem.mesh.edges import faces_across
from warpqem.runtime import new_arrays
from warpqem.runtime.launches import launch

__all__ = ["Cells", "Joined", "cell_places"]

# Faces in a leaf of the hierarchy: searches take a quarter less time than with one, or with more.
LEAF_FACES = 2

Doubles = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Joined:
    """Meshes as one: their faces in terms of the vertices of all, one mesh after another.

    Attributes:
        faces: (N, 3) int.
        first_face: (M+1,) int, the first face of each mesh, and behind them N.
        first_vertex: (M+1,) int, likewise of vertices.
    """

    faces: npt.NDArray[np.integer]
    first_face: Ints
    first_vertex: Ints

    @classmethod
    def single(cls, faces: npt.NDArray[np.integer]) -> Joined:
        """One mesh."""
        return cls(faces, np.array([0, len(faces)]), np.array([0, int(faces.max(initial=-1)) + 1]))

    @classmethod
    def of(cls, meshes: Sequence[npt.NDArray[np.integer]], vertex_counts: Sequence[int]) -> Joined:
        """Meshes of faces (N, 3) each, and so many vertices."""
        if len(meshes) == 1:
            return cls.single(meshes[0])
        first_face, first_vertex = (
            np.concatenate([[0], np.cumsum(counts)]) for counts in (list(map(len, meshes)), vertex_counts)
        )
        moved = [faces + first for faces, first in zip(meshes, first_vertex.tolist(), strict=False)]
        return cls(np.concatenate(moved), first_face, first_vertex)


class Cells:
    """Meshes on the device in a group of frames; several meshes in one frame.

    Cells are numbered frame after frame, and in a frame mesh after mesh. Each mesh has a hierarchy of its own, as bits
    of the angles depend on it.

    Args:
        joined: M meshes.
        group: frames G, 1 where there are several meshes.
        name: what messages call a mesh.
        device: Warp device.

    Attributes:
        used: vertices that a face uses, ascending; the others are no part of the surface.
        faces: (N, 3) int32 in terms of these.
        face_count: faces N.
        first_face: (M+1,) int, the first face of each mesh.
        first_point: (M+1,) int, the first of the vertices in use of each mesh.
        corner_vertex: (3N,) int32 on the device.
        surface: the cells on the device.
        table: where the cells are in it.
        nearest: (N,) int32 on the device, the face of the other mesh nearest to the middle of each face when it was
            last looked for; -1 for none.
    """

    def __init__(self, joined: Joined, group: int, name: str, device: str) -> None:
        self.name, self._group, self._device = name, group, device
        faces = joined.faces
        self.used = np.unique(faces)
        self.faces = np.searchsorted(self.used, faces).astype(np.int32)
        self.face_count = len(faces)
        self.first_face = joined.first_face
        self.first_point = np.searchsorted(self.used, joined.first_vertex)
        self.corner_vertex = new_arrays.uploaded(self.faces.ravel(), dtype=wp.int32, device=device)
        first_point = len(self.used) * np.arange(group, dtype=np.int32)
        corners = (self.faces.ravel() + first_point[:, None]).ravel()
        self.surface = Surface()
        self.surface.corner_vertex = new_arrays.uploaded(corners, dtype=wp.int32, device=device)
        across = faces_across(self.faces)
        first_face = np.int32(self.face_count) * np.arange(group, dtype=np.int32)[:, None]
        across = np.where(across < 0, across, across + first_face).ravel()
        self.surface.across = new_arrays.uploaded(across, dtype=wp.int32, device=device)
        self.nearest = new_arrays.full(self.face_count, -1, dtype=wp.int32, device=device)
        self.table = CellTable()
        first = np.append(np.add.outer(first_face[:, 0], self.first_face[:-1]).ravel(), group * self.face_count)
        self.table.first_face = new_arrays.uploaded(first, dtype=wp.int32, device=device)
        # Those of a mesh in several frames are in one hierarchy.
        self.table.mesh_first = new_arrays.uploaded(np.tile(self.first_face[:-1], group), dtype=wp.int32, device=device)
        self._meshes: list[wp.Mesh] = []
        self._first: Doubles | None = None

    def move(self, points: Doubles, places: Doubles) -> None:
        """Show a group of frames (n, U, 3) of the vertices in use, in cells with middles (G, 3).

        Cells without a frame of their own show the last one. The hierarchy is built once and refitted to the others:
        which of several faces as near as each other is found then depends on the first frames, and on nothing else.
        """
        if self._first is None:
            self._first = points[0]
        missing = self._group - len(points)
        if missing:
            points = np.concatenate([points, np.repeat(points[-1:], missing, axis=0)])
        flat = (points + places[:, None]).reshape(-1, 3) if len(places) > 1 else points[0]
        self.surface.points = new_arrays.uploaded(flat, dtype=wp.vec3d, device=self._device)
        single = new_arrays.uploaded(flat.astype(np.float32), dtype=wp.vec3, device=self._device)
        ends = (self._group * self.first_point).tolist()
        parts = [new_arrays.part(single, first, last) for first, last in itertools.pairwise(ends)]
        if self._meshes:
            for mesh, part in zip(self._meshes, parts, strict=True):
                # Setting the points refits the hierarchy.
                mesh.points = part
            return
        self._meshes = [
            wp.Mesh(points=part, indices=corners, bvh_leaf_size=LEAF_FACES)
            for part, corners in zip(parts, self._corners(), strict=True)
        ]
        numbers = np.tile(np.array([mesh.id for mesh in self._meshes], dtype=np.uint64), self._group)
        self.table.mesh = new_arrays.uploaded(numbers, dtype=wp.uint64, device=self._device)

    def _corners(self) -> list[wp.array]:
        """The vertex at each corner of the cells of each mesh, in terms of the mesh's own."""
        if self.mesh_count == 1:
            return [self.surface.corner_vertex]
        own = self.faces.ravel() - np.repeat(self.first_point[:-1], 3 * np.diff(self.first_face))
        corners = new_arrays.uploaded(own, dtype=wp.int32, device=self._device)
        ends = (3 * self.first_face).tolist()
        return [new_arrays.part(corners, first, last) for first, last in itertools.pairwise(ends)]

    @property
    def mesh_count(self) -> int:
        """Meshes M."""
        return len(self.first_face) - 1

    def faces_of(self, mesh: int) -> slice:
        """The faces of one of the meshes."""
        return slice(int(self.first_face[mesh]), int(self.first_face[mesh + 1]))

    def bounds(self, points: Doubles) -> tuple[Doubles, Doubles]:
        """The lowest and highest corner (n, M, 3) of each mesh in frames (n, U, 3) of the vertices in use."""
        if self.mesh_count == 1:
            return points.min(axis=1, keepdims=True), points.max(axis=1, keepdims=True)
        first = self.first_point[:-1]
        return np.minimum.reduceat(points, first, axis=1), np.maximum.reduceat(points, first, axis=1)

    def of_points(self, values: Doubles) -> Doubles:
        """Values (n, M, ...) of meshes at the vertices in use, (n, U, ...); (n, 1, ...) where there is one."""
        return values if self.mesh_count == 1 else np.repeat(values, np.diff(self.first_point), axis=1)

    @cached_property
    def mesh_of_face(self) -> npt.NDArray[np.int32]:
        """(N,) the mesh of each face, which is its cell in the first frame."""
        return np.repeat(np.arange(self.mesh_count, dtype=np.int32), np.diff(self.first_face))

    @cached_property
    def winding(self) -> Winding:
        """What the winding of the faces says in the first frame, found when it is first needed."""
        assert self._first is not None
        if self.mesh_count == 1:
            return read_winding(self._first, self.faces)
        mesh = np.repeat(np.arange(self.mesh_count), np.diff(self.first_point))
        return read_winding(self._first, self.faces, mesh)

    def areas(self) -> Doubles:
        """Face areas (G, N)."""
        area = new_arrays.empty(self._group * self.face_count, dtype=wp.float64, device=self._device)
        launch(kernels.face_areas, dim=len(area), inputs=[self.surface], outputs=[area], device=self._device)
        found: Doubles = area.numpy().reshape(self._group, -1)
        return found


def cell_places(group: int, reach: float) -> Doubles:
    """Middles (G, 3) of cells: so far apart that a mesh is nearer to its own points than any other cell is.

    Args:
        group: cells G.
        reach: the largest coordinate of a point from the middle of its cell.
    """
    if group == 1:
        return np.zeros((1, 3))
    side = math.ceil(round(group ** (1 / 3), 6))
    index = np.stack(np.unravel_index(np.arange(group), (side, side, side)), axis=1)
    # Points of a cell are within 2 sqrt(3) reaches of each other, and the next cell begins 2 reaches before its middle
    # is reached.
    return (index - (side - 1) / 2) * (6.0 * reach)
