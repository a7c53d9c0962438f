"""A bound on the distance between two meshes in motion that is proved for every point, not read off samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.kernels import distance_bound as kernels
from warpqem.launches import launch
from warpqem.parallel import launch_parts

__all__ = ["DistanceBound", "Excess"]

# Triangles that are worth a thread: some microseconds each.
MIN_PART = 256


@dataclass(frozen=True)
class Excess:
    """Faces that are not within the limit, in one frame.

    Attributes:
        frame: the frame.
        reference_faces: int indices, faces of the reference too far from the test mesh, or not proved to be near.
        test_faces: the same the other way round.
    """

    frame: int
    reference_faces: npt.NDArray[np.int64]
    test_faces: npt.NDArray[np.int64]


class _Mover:
    """One mesh on the device, frame after frame."""

    def __init__(self, faces: npt.NDArray[np.int32], device: str) -> None:
        self._device, self._mesh = device, None
        # Points without a face are no part of the surface.
        self._used = np.unique(faces)
        self.faces = np.searchsorted(self._used, faces).astype(np.int32)
        self.surface = kernels.Surface()
        self.surface.corner_vertex = wp.array(self.faces.ravel(), dtype=wp.int32, device=device)
        self.vertex_hint = wp.full(len(self._used), -1, dtype=wp.int32, device=device)
        self.face_hint = wp.full((len(faces), int(kernels.HINTS)), -1, dtype=wp.int32, device=device)

    def move(self, points: npt.NDArray[np.float64]) -> None:
        """Show a frame (V, 3). The hierarchy is refitted: where it leads the search decides no verdict."""
        points = points[self._used]
        self.surface.points = wp.array(points, dtype=wp.vec3d, device=self._device)
        single = wp.array(points.astype(np.float32), dtype=wp.vec3, device=self._device)
        if self._mesh is None:
            self._mesh = wp.Mesh(points=single, indices=self.surface.corner_vertex)
        else:
            self._mesh.points = single
        self.surface.mesh = self._mesh.id


class DistanceBound:
    """Proves that two meshes are within a limit of each other, both ways, in one frame after another.

    Args:
        reference_faces: (N, 3) int.
        test_faces: (M, 3) int.
        limit: in units of the points, which are to be of about unit size around the origin.
        device: Warp device.
    """

    def __init__(
        self, reference_faces: npt.NDArray[np.int32], test_faces: npt.NDArray[np.int32], limit: float, device: str
    ) -> None:
        self._limit, self._device = float(limit), device
        self._reference, self._test = _Mover(reference_faces, device), _Mover(test_faces, device)

    def excess(self, frame: int, reference: npt.NDArray[np.float64], test: npt.NDArray[np.float64]) -> Excess | None:
        """Where the limit does not hold; None where it holds everywhere.

        Args:
            frame: number of the frame, for the answer.
            reference: (V, 3) points of the reference.
            test: (W, 3) points of the test mesh.
        """
        self._reference.move(reference)
        self._test.move(test)
        beyond = [self._vertices_beyond(own, other) for own, other in self._pairs()]
        if not any(len(faces) for faces in beyond):
            beyond = [self._faces_beyond(own, other) for own, other in self._pairs()]
        if not any(len(faces) for faces in beyond):
            return None
        return Excess(frame, *beyond)

    def _pairs(self) -> tuple[tuple[_Mover, _Mover], tuple[_Mover, _Mover]]:
        return (self._reference, self._test), (self._test, self._reference)

    def _vertices_beyond(self, own: _Mover, other: _Mover) -> npt.NDArray[np.int64]:
        """Faces with a vertex beyond the limit. Vertices are few, and soon show a limit that is far off."""
        verdict = self._verdicts(kernels.bound_vertices, own, other, len(own.vertex_hint), own.vertex_hint)
        if not verdict.any():
            return np.empty(0, dtype=np.int64)
        return np.flatnonzero(verdict[own.faces].any(axis=1))

    def _faces_beyond(self, own: _Mover, other: _Mover) -> npt.NDArray[np.int64]:
        return np.flatnonzero(self._verdicts(kernels.bound_triangles, own, other, len(own.faces), own.face_hint))

    def _verdicts(
        self, kernel: wp.Kernel, own: _Mover, other: _Mover, count: int, hint: wp.array
    ) -> npt.NDArray[np.int32]:
        verdict = wp.empty(count, dtype=wp.int32, device=self._device)

        def bound(part: slice) -> None:
            launch(
                kernel,
                dim=part.stop - part.start,
                inputs=[own.surface, other.surface, self._limit, part.start, hint],
                outputs=[verdict],
                device=self._device,
            )

        launch_parts(bound, count, self._device, MIN_PART)
        return verdict.numpy()
