"""Errors of the motion: change of the error field, sliding of bound vertices, edge lengths."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from warpqem.measure.binding import Binding
from warpqem.measure.collapsed import Standing
from warpqem.measure.sampling import TINY, normals_and_areas, place
from warpqem.measure.validity import unique_edges

__all__ = ["BindingErrors", "SecondDifference", "binding_errors", "in_face_frame"]

# Smallest edge length, as a fraction of the mean diagonal, that a relative edge-length error is taken of: bound points
# may coincide, and the error relative to nothing would drown all others.
EDGE_LENGTH_FLOOR = 1e-6

# A few vertices on another leg decide a root mean square and leave this percentile alone; most that slide raise both.
SLIDE_PERCENTILE = 95.0


class SecondDifference:
    """Root mean square length of the second temporal difference of vectors that come frame by frame."""

    def __init__(self) -> None:
        """Start without any frame."""
        self._recent: list[npt.NDArray[np.float64]] = []
        self._sum: npt.NDArray[np.float64] | None = None
        self._count = 0

    def restart(self) -> None:
        """Forget the frames so far: what comes next does not follow them."""
        self._recent = []

    def add(self, vectors: npt.NDArray[np.float64]) -> None:
        """Take the vectors (S, 3) of the next frame."""
        if len(self._recent) == 2:
            before, last = self._recent
            squared = ((vectors - 2 * last + before) ** 2).sum(axis=1)
            self._sum = squared if self._sum is None else self._sum + squared
            self._count += 1
        self._recent = [*self._recent[-1:], vectors]

    def root_mean_square(self) -> float | None:
        """The value over all frames so far; None below three frames, where no second difference exists."""
        return None if self._sum is None else float(np.sqrt(self._sum.mean() / self._count))

    def percentile(self, percent: float) -> float | None:
        """That percentile, over the vectors, of each one's root mean square over time; None below three frames."""
        return None if self._sum is None else float(np.percentile(np.sqrt(self._sum / self._count), percent))


def in_face_frame(
    vectors: npt.NDArray[np.float64],
    points: npt.NDArray[np.float64],
    faces: npt.NDArray[np.int64],
    face: npt.NDArray[np.integer],
) -> npt.NDArray[np.float64]:
    """Vectors (S, 3) in the orthonormal frames of the given faces (S,), so that a rigid motion leaves them unchanged.

    The axes are the first edge, the normal crossed with it, and the normal.
    """
    corner = faces[face]
    edge = points[corner[:, 1]] - points[corner[:, 0]]
    edge = edge / np.maximum(np.linalg.norm(edge, axis=1, keepdims=True), TINY)
    normal = normals_and_areas(points, corner)[0]
    axes = np.stack([edge, np.cross(normal, edge), normal], axis=1)
    return np.einsum("sij,sj->si", axes, vectors)


@dataclass(frozen=True)
class BindingErrors:
    """Motion of the test vertices against the material points of the reference they are bound to, in %.

    Attributes:
        slide: root mean square second temporal difference of the vertices' offsets from their material points, in the
            frame of the bound face, in % of the mean diagonal; None below three frames.
        slide_p95: the 95th percentile over the vertices, each with its root mean square over time.
        edge_length_error: root mean square relative error of test edges against the same edges between the material
            points: the spatial part of Vasa and Skala, "A Perception Correlated Comparison Method for Dynamic Meshes"
            (2011), which itself needs equal connectivity.
    """

    slide: float | None
    slide_p95: float | None
    edge_length_error: float


def binding_errors(meshes: Standing, binding: Binding, diagonal: npt.NDArray[np.float64]) -> BindingErrors:
    """Slide and edge-length error of the test mesh.

    Args:
        meshes: the sequence the test mesh is bound to, and the test mesh's.
        binding: the material points of the test vertices in use.
        diagonal: (F,) diagonals of the reference frames.
    """
    reference, test = meshes.reference, meshes.test
    edges = np.searchsorted(test.used, unique_edges(test.faces)[0])
    floor = EDGE_LENGTH_FLOOR * diagonal.mean()
    slide = SecondDifference()
    squared_error = 0.0
    for reference_points, test_points, follows in zip(reference.points, test.points, meshes.follows, strict=True):
        if not follows:
            slide.restart()
        anchor = place(reference_points, reference.faces, binding.face, binding.barycentric)
        vertex = test_points[test.used]
        slide.add(in_face_frame(vertex - anchor, reference_points, reference.faces, binding.face))
        length, expected = (np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1) for x in (vertex, anchor))
        squared_error += float((((length - expected) / np.maximum(expected, floor)) ** 2).mean())
    unit = 100 / float(diagonal.mean())
    root_mean_square, p95 = slide.root_mean_square(), slide.percentile(SLIDE_PERCENTILE)
    return BindingErrors(
        slide=None if root_mean_square is None else unit * root_mean_square,
        slide_p95=None if p95 is None else unit * p95,
        edge_length_error=100 * float(np.sqrt(squared_error / len(reference.points))),
    )
