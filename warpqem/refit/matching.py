"""Pairs of nearest points between the input and the output surface, both ways, on the key frames."""

from __future__ import annotations

import numpy as np
import warp as wp

from warpqem.kernels import refit as kernels
from warpqem.kernels.surface_walk import Surface
from warpqem.order.stars import Stars
from warpqem.parallel import launch_parts
from warpqem.place.rows import group_rows

__all__ = ["Matching", "make_surface"]

# The 12 points of Dunavant's rule of degree 6 (1985), as the weights of the corners: some near the corners and edges,
# where a coarse face leaves the surface, and some inside. All weigh the same here.
_NEAR_CORNER, _INSIDE, _SIDE, _EDGE = 0.063089014491502, 0.249286745170910, 0.310352451033785, 0.053145049844816
OUTPUT_SAMPLES = np.array(
    [np.roll([1 - 2 * a, a, a], k) for a in (_INSIDE, _NEAR_CORNER) for k in range(3)]
    + [
        np.roll(row, k)
        for row in ([_SIDE, _EDGE, 1 - _SIDE - _EDGE], [_EDGE, _SIDE, 1 - _SIDE - _EDGE])
        for k in range(3)
    ]
)


def make_surface(points: wp.array, corner_vertex: wp.array, stars: Stars) -> Surface:
    """The struct that kernels walk on: points (K, V) vec3, corner_vertex (3N,) int32."""
    surface = Surface()
    surface.points = points
    surface.corner_vertex = corner_vertex
    surface.star_start, surface.star_corner = stars.start, stars.corner
    return surface


class Matching:
    """Pairs of points, found again from where they were after every move of the output.

    Args:
        source: the input on K key frames.
        target: the output on the same frames, as placed.
        vertex_map: (V,) int32, input vertex to output vertex, -1 for a vertex without a face.
        faces: (N, 3) int32, the input's.
        out_faces: (N', 3) int32.
        nearest: (C,) int32, an input vertex near to each output vertex.
        turns: frames in which each sample is paired.
        device: Warp device.

    Attributes:
        input_pairs: from points of the input to the output.
        output_pairs: from points of the output to the input, a fixed number for each face.
        input_start: (N'+1,) int32, first entry of each output face in ``input_order``.
        input_order: int32, input pairs by output face.
    """

    def __init__(
        self,
        source: Surface,
        target: Surface,
        vertex_map: np.ndarray,
        faces: np.ndarray,
        out_faces: np.ndarray,
        nearest: np.ndarray,
        turns: int,
        device: str,
    ) -> None:
        self._source, self._turns, self._device = source, turns, device
        self._source_mesh, self._target_mesh = _Hierarchy(source), _Hierarchy(target)
        self._face_count = len(out_faces)
        # A walk starts at the corner that a point lies nearest to.
        start = np.concatenate([vertex_map[faces[:, 0]], vertex_map])
        self.input_pairs = _empty_pairs(np.repeat(start, turns), device)
        corner = OUTPUT_SAMPLES.argmax(axis=1)
        start = nearest[out_faces[:, corner]].ravel()
        self.output_pairs = _empty_pairs(np.repeat(start, turns), device)
        self._barycentric = wp.array(OUTPUT_SAMPLES, dtype=wp.vec3, device=device)

    def find(self, target: Surface, reach: float) -> None:
        """Pair the output as it lies now; points further apart than ``reach`` are no pair."""
        for key in range(len(target.points)):
            self._source_mesh.show(self._source, key)
            self._target_mesh.show(target, key)
            inputs = [reach, self._source, target]
            self._launch(kernels.match_input_samples, key, [*inputs, self._target_mesh.id], self.input_pairs)
            inputs += [self._source_mesh.id, self._barycentric]
            self._launch(kernels.match_output_samples, key, inputs, self.output_pairs)
        face = self.input_pairs.face.numpy()
        hit = np.flatnonzero(face >= 0)
        order, start = group_rows(face[hit], self._face_count)
        self.input_start = wp.array(start, dtype=wp.int32, device=self._device)
        self.input_order = wp.array(hit[order], dtype=wp.int32, device=self._device)

    def _launch(self, kernel: wp.Kernel, key: int, inputs: list[object], pairs: kernels.Pairs) -> None:
        key_count = len(self._source.points)
        # As many as the first frame has; the kernel leaves out those past the end.
        count = -(-len(pairs.face) // (key_count * self._turns)) * self._turns

        def match(part: slice) -> None:
            turns = kernels.Turns()
            turns.first, turns.count, turns.key, turns.key_count = part.start, self._turns, key, key_count
            wp.launch(kernel, dim=part.stop - part.start, inputs=[turns, *inputs], outputs=[pairs], device=self._device)

        launch_parts(kernel, match, count, self._device)


class _Hierarchy:
    """The search hierarchy of a moving mesh: built once, then fitted to one frame after the other."""

    def __init__(self, surface: Surface) -> None:
        # A mesh keeps its points, and they change from frame to frame.
        self._mesh = wp.Mesh(points=wp.clone(surface.points[0]), indices=surface.corner_vertex)

    @property
    def id(self) -> int:
        """What kernels know it by."""
        return int(self._mesh.id)

    def show(self, surface: Surface, key: int) -> None:
        """Fit it to a frame of a surface of the same faces."""
        wp.copy(self._mesh.points, surface.points[key])
        self._mesh.refit()


def _empty_pairs(start: np.ndarray, device: str) -> kernels.Pairs:
    pairs, count = kernels.Pairs(), len(start)
    pairs.face = wp.empty(count, dtype=wp.int32, device=device)
    pairs.key = wp.empty(count, dtype=wp.int32, device=device)
    pairs.barycentric = wp.empty(count, dtype=wp.vec3, device=device)
    pairs.normal = wp.empty(count, dtype=wp.vec3, device=device)
    pairs.residual = wp.empty(count, dtype=wp.float32, device=device)
    pairs.weight = wp.empty(count, dtype=wp.float32, device=device)
    pairs.start = wp.array(start, dtype=wp.int32, device=device)
    return pairs
