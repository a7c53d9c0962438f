"""Pairs of nearest points between the input and the output surface, both ways, on the key frames."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import warp as wp

from warpqem.kernels import refit as kernels
from warpqem.kernels.surface_walk import Surface
from warpqem.order.stars import Stars
from warpqem.parallel import run_parts, split_range, thread_count
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
        vertex_map: np.ndarray,
        faces: np.ndarray,
        out_faces: np.ndarray,
        nearest: np.ndarray,
        turns: int,
        device: str,
    ) -> None:
        self._source, self._turns, self._device = source, turns, device
        self._face_count = len(out_faces)
        # A walk starts at the corner that a point lies nearest to.
        start = np.concatenate([vertex_map[faces[:, 0]], vertex_map])
        self.input_pairs = _empty_pairs(np.repeat(start, turns), device)
        corner = OUTPUT_SAMPLES.argmax(axis=1)
        start = nearest[out_faces[:, corner]].ravel()
        self.output_pairs = _empty_pairs(np.repeat(start, turns), device)
        self._barycentric = wp.array(OUTPUT_SAMPLES, dtype=wp.vec3, device=device)

    def find(self, target: Surface) -> None:
        """Pair the output as it lies now."""
        self._launch(kernels.match_input_samples, target, [], self.input_pairs)
        self._launch(kernels.match_output_samples, target, [self._barycentric], self.output_pairs)
        face = self.input_pairs.face.numpy()
        hit = np.flatnonzero(face >= 0)
        order, start = group_rows(face[hit], self._face_count)
        self.input_start = wp.array(start, dtype=wp.int32, device=self._device)
        self.input_order = wp.array(hit[order], dtype=wp.int32, device=self._device)

    def _launch(self, kernel: wp.Kernel, target: Surface, more: list[wp.array], pairs: kernels.Pairs) -> None:
        def match(part: slice) -> None:
            wp.launch(
                kernel,
                dim=part.stop - part.start,
                inputs=[part.start, self._turns, self._source, target, *more],
                outputs=[pairs],
                device=self._device,
            )

        parts: list[Callable[[], object]] = [
            partial(match, part) for part in split_range(len(pairs.face), thread_count(self._device))
        ]
        run_parts(parts)


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
