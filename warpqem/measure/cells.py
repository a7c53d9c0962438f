"""A mesh on the device in several frames at once: each frame is a cell of one mesh."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.kernels import surface_distance as kernels
from warpqem.kernels.near_faces import Surface
from warpqem.measure.winding import Winding, read_winding
from warpqem.mesh.edges import faces_across
from warpqem.runtime import new_arrays
from warpqem.runtime.launches import launch

__all__ = ["Cells", "cell_places"]

# Faces in a leaf of the hierarchy: searches take a quarter less time than with one, or with more.
LEAF_FACES = 2

Doubles = npt.NDArray[np.float64]


class Cells:
    """One mesh on the device, in a group of frames.

    Args:
        faces: (N, 3) int.
        group: frames G.
        name: what messages call the mesh.
        device: Warp device.

    Attributes:
        used: vertices that a face uses, ascending; the others are no part of the surface.
        faces: (N, 3) int32 in terms of these.
        face_count: faces N.
        corner_vertex: (3N,) int32 on the device.
        surface: the cells on the device, numbered frame after frame.
        nearest: (N,) int32 on the device, the face of the other mesh nearest to the middle of each face when it was
            last looked for; -1 for none.
    """

    def __init__(self, faces: npt.NDArray[np.integer], group: int, name: str, device: str) -> None:
        self.name, self._group, self._device = name, group, device
        self.used = np.unique(faces)
        self.faces = np.searchsorted(self.used, faces).astype(np.int32)
        self.face_count = len(faces)
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
        self._mesh: wp.Mesh | None = None
        self._first: Doubles | None = None
        self._winding: Winding | None = None

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
        if self._mesh is None:
            self._mesh = wp.Mesh(points=single, indices=self.surface.corner_vertex, bvh_leaf_size=LEAF_FACES)
        else:
            # Setting the points refits the hierarchy.
            self._mesh.points = single
        self.surface.mesh = self._mesh.id

    @property
    def winding(self) -> Winding:
        """What the winding of the faces says in the first frame, found when it is first needed."""
        assert self._first is not None
        if self._winding is None:
            self._winding = read_winding(self._first, self.faces)
        return self._winding

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
