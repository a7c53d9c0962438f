"""Errors of the motion: change of the error field, sliding of bound vertices, edge lengths."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from warpqem.measure.distance import ClosestPointSearch
from warpqem.measure.inputs import MeshSequence
from warpqem.measure.sampling import TINY, normals_and_areas, place
from warpqem.measure.topology import unique_edges

__all__ = ["SecondDifference", "binding_errors", "in_face_frame"]

# Smallest edge length, as a fraction of the mean diagonal, that a relative edge-length error is taken of: bound points
# may coincide, and the error relative to nothing would drown all others.
EDGE_LENGTH_FLOOR = 1e-6


class SecondDifference:
    """Root mean square length of the second temporal difference of vectors that come frame by frame."""

    def __init__(self) -> None:
        """Start without any frame."""
        self._recent: list[npt.NDArray[np.float64]] = []
        self._sum = 0.0
        self._count = 0

    def add(self, vectors: npt.NDArray[np.float64]) -> None:
        """Take the vectors (S, 3) of the next frame."""
        if len(self._recent) == 2:
            before, last = self._recent
            self._sum += float(((vectors - 2 * last + before) ** 2).sum())
            self._count += len(vectors)
        self._recent = [*self._recent[-1:], vectors]

    def root_mean_square(self) -> float | None:
        """The value over all frames so far; None below three frames, where no second difference exists."""
        return float(np.sqrt(self._sum / self._count)) if self._count else None


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


def binding_errors(
    reference: MeshSequence,
    test: MeshSequence,
    centre: npt.NDArray[np.float64],
    diagonal: npt.NDArray[np.float64],
    device: str,
) -> tuple[float | None, float]:
    """Slide and edge-length error of the test mesh, both in %.

    Every test vertex in use is bound to the reference material point nearest to it in frame 0. Slide is the root mean
    square second temporal difference of the vertices' offsets from their bound points, in the frame of the bound
    face, in % of the mean diagonal (None below three frames). The edge-length error is the root mean square relative
    error of test edges against the same edges between bound points: the spatial part of Vasa and Skala, "A Perception
    Correlated Comparison Method for Dynamic Meshes" (2011), which itself needs equal connectivity.

    Args:
        reference: sequence the test mesh is bound to.
        test: sequence with as many frames.
        centre: (F, 3) centres of the reference frames.
        diagonal: (F,) diagonals of the reference frames.
        device: Warp device name.
    """
    scaled = [(mesh.points[0] - centre[0]) / diagonal[0] for mesh in (reference, test)]
    search = ClosestPointSearch(reference.faces, device, "reference")
    bound = search.closest(scaled[0], scaled[1][test.used], 0)

    edges = np.searchsorted(test.used, unique_edges(test.faces)[0])
    floor = EDGE_LENGTH_FLOOR * diagonal.mean()
    slide = SecondDifference()
    squared_error = 0.0
    for reference_points, test_points in zip(reference.points, test.points, strict=True):
        anchor = place(reference_points, reference.faces, bound.face, bound.barycentric)
        vertex = test_points[test.used]
        slide.add(in_face_frame(vertex - anchor, reference_points, reference.faces, bound.face))
        length, expected = (np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1) for x in (vertex, anchor))
        squared_error += float((((length - expected) / np.maximum(expected, floor)) ** 2).mean())
    slid = slide.root_mean_square()
    edge_length_error = 100 * float(np.sqrt(squared_error / len(reference.points)))
    return None if slid is None else 100 * slid / float(diagonal.mean()), edge_length_error
