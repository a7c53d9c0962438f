"""Closest points on a mesh, one frame at a time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.errors import DegenerateMeshError
from warpqem.kernels.closest_point import find_closest_points
from warpqem.runtime import new_arrays
from warpqem.runtime.launches import launch

__all__ = ["Closest", "ClosestPointSearch"]


@dataclass(frozen=True)
class Closest:
    """Closest points of a mesh to S queries.

    Attributes:
        distance: (S,) float64.
        face: (S,) int32.
        barycentric: (S, 3) float64.
    """

    distance: npt.NDArray[np.float64]
    face: npt.NDArray[np.int32]
    barycentric: npt.NDArray[np.float64]

    def part(self, start: int, stop: int) -> Closest:
        """The answers to queries start..stop."""
        return Closest(self.distance[start:stop], self.face[start:stop], self.barycentric[start:stop])


class ClosestPointSearch:
    """Finds closest points on the frames of one mesh.

    The hierarchy is built anew for every frame rather than refitted: a refitted one slows down as the mesh moves away
    from the pose it was built in, and where two faces are equally near its answer would depend on the frames before.
    """

    def __init__(self, faces: npt.NDArray[np.int64], device: str, name: str) -> None:
        """Upload faces (N, 3); name is what messages call the mesh."""
        self._indices = new_arrays.uploaded(faces.ravel(), dtype=wp.int32, device=device)
        self._device = device
        self._name = name
        # The hierarchy of the points that were searched last.
        self.mesh: wp.Mesh | None = None

    def closest(self, points: npt.NDArray[np.float64], queries: npt.NDArray[np.float64], frame: int) -> Closest:
        """Closest points of the mesh with points (V, 3) to queries (S, 3).

        Both must be scaled to about unit size around the origin: the search runs in single precision, the distances
        and barycentric coordinates are computed in double precision.

        Raises:
            DegenerateMeshError: every face is a sliver, so there is nothing to search; the message names the frame.
        """
        device = self._device
        exact_points = new_arrays.uploaded(points, dtype=wp.vec3d, device=device)
        mesh = self.mesh = wp.Mesh(
            points=new_arrays.uploaded(points, dtype=wp.vec3, device=device), indices=self._indices
        )
        distance = new_arrays.zeros(len(queries), dtype=wp.float64, device=device)
        face = new_arrays.zeros(len(queries), dtype=wp.int32, device=device)
        barycentric = new_arrays.zeros(len(queries), dtype=wp.vec3d, device=device)
        launch(
            find_closest_points,
            dim=len(queries),
            inputs=[mesh.id, exact_points, self._indices, new_arrays.uploaded(queries, dtype=wp.vec3d, device=device)],
            outputs=[distance, face, barycentric],
            device=device,
        )
        result = Closest(distance.numpy(), face.numpy(), barycentric.numpy())
        if (result.face < 0).any():
            raise DegenerateMeshError(f"{self._name} mesh: every face is degenerate in frame {frame}")
        return result
