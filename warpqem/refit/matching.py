"""Pairs of nearest points between the input and the output surface, both ways, on the key frames."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
import warp as wp

from warpqem.decimation.adjacency import Adjacency, build_adjacency
from warpqem.kernels import surface_limits as limit_kernels
from warpqem.kernels import surface_pairs as kernels
from warpqem.kernels import surface_walk as walk_kernels
from warpqem.kernels.refit import BORDER_WIDTH, SEAM_WIDTH
from warpqem.kernels.surface_limits import Limits, Samples
from warpqem.kernels.surface_walk import Surface
from warpqem.runtime import new_arrays
from warpqem.runtime.device import device_traits
from warpqem.runtime.launches import launch
from warpqem.runtime.part_launches import FIRST_ITEM, PerPart, launch_in_parts, rows_of

__all__ = ["OUTPUT_SAMPLES", "Matching", "make_surface"]


def _turned(*barycentric: float) -> list[np.ndarray]:
    """The same point seen from each corner."""
    return [np.roll(barycentric, k) for k in range(3)]


def _symmetric(a: float) -> list[np.ndarray]:
    return _turned(1 - 2 * a, a, a)


# The points of Dunavant's rule of degree 6 (1985), as the weights of the corners: some near the corners and edges,
# where a coarse face leaves the surface, and some inside. All points weigh the same here. The six points of degree 4
# fit half the faces 1.6 % worse.
_SIDE, _EDGE = 0.310352451033785, 0.053145049844816
OUTPUT_SAMPLES = np.array(
    _symmetric(0.249286745170910)
    + _symmetric(0.063089014491502)
    + _turned(_SIDE, _EDGE, 1 - _SIDE - _EDGE)
    + _turned(_EDGE, _SIDE, 1 - _SIDE - _EDGE)
)

# Points on an edge of a border or seam. Output edges are long, and the line leaves them anywhere between their ends.
INPUT_LINE_SAMPLES = 1
OUTPUT_LINE_SAMPLES = 4


def make_surface(
    points: wp.array, corner_vertex: wp.array, adjacency: Adjacency, seam: np.ndarray | None = None
) -> Surface:
    """The struct that kernels walk on: points (K, V) vec3, corner_vertex (3N,) int32, and marks (3N,) of seams."""
    device, vertex_count = corner_vertex.device, len(adjacency.start) - 1
    surface = Surface()
    surface.points = points
    surface.corner_vertex = corner_vertex
    if seam is not None:
        surface.seam = new_arrays.uploaded(seam, dtype=wp.int32, device=device)
    surface.adjacency_start, surface.adjacent_corner = adjacency.start, adjacency.corner
    surface.opposite = new_arrays.like(corner_vertex)
    surface.border_out, surface.border_in = (
        new_arrays.full(vertex_count, -1, dtype=wp.int32, device=device) for _ in range(2)
    )
    launch(
        walk_kernels.link_half_edges,
        dim=len(corner_vertex) // 3,
        inputs=[surface],
        outputs=[surface.opposite, surface.border_out, surface.border_in],
        device=device,
    )
    return surface


class Matching:
    """Pairs of points, found again from where they were after every move of the output.

    Args:
        source: the input on K key frames.
        target: the output on the same frames, as placed; its points are what :meth:`find` pairs.
        vertex_map: (V,) int32, input vertex to output vertex, -1 for a vertex without a face.
        faces: (N, 3) int32, the input's.
        out_faces: (N', 3) int32.
        nearest: (C,) int32 on the device, an input vertex near to each output vertex, on a border where that is.
        turns: frames in which each sample is paired.
        sizes: (SIZES,) float32 on the device, see :class:`warpqem.refit.scales.FitSizes`: lengths of borders and seams
            count as strips so wide.
        borders: half-edges without an opposite one of the input and of the output.
        seams: half-edges of seams of both, one of each edge.
        device: Warp device.

    Attributes:
        input_pairs: from points of the input to the output, and those of borders and seams both ways.
        output_pairs: from points of the output to the input, a fixed number for each face.
        input_start: (N'+1,) int32, first entry of each output face in ``input_order``.
        input_order: int32, input pairs by output face; what comes after the last one says nothing.
    """

    def __init__(
        self,
        source: Surface,
        target: Surface,
        vertex_map: np.ndarray,
        faces: np.ndarray,
        out_faces: np.ndarray,
        nearest: wp.array,
        turns: int,
        sizes: wp.array,
        borders: tuple[np.ndarray, np.ndarray],
        seams: tuple[np.ndarray, np.ndarray],
        device: str,
    ) -> None:
        self._source, self._target, self._turns, self._device = source, target, turns, device
        self._face_count = len(out_faces)
        self._to_output = new_arrays.uploaded(vertex_map, dtype=wp.int32, device=device)
        self._to_input, self._sizes = nearest, sizes
        self._hierarchies = _Hierarchy(source), _Hierarchy(target)
        self._lines = tuple(
            ([new_arrays.uploaded(half_edge, dtype=wp.int32, device=device) for half_edge in half_edges], width)
            for half_edges, width in ((borders, BORDER_WIDTH), (seams, SEAM_WIDTH))
        )
        self._sample_count = (len(faces) + len(vertex_map)) * turns
        # Two pairs at each point of a border or seam.
        line_pairs = sum(2 * turns * sum(_line_samples(half_edges)) for half_edges, _ in self._lines)
        self.input_pairs = _empty_pairs(self._sample_count + line_pairs, device)
        self.output_pairs = _empty_pairs(len(OUTPUT_SAMPLES) * len(out_faces) * turns, device)
        self._barycentric = new_arrays.uploaded(OUTPUT_SAMPLES, dtype=wp.vec3, device=device)
        face_of_vertex = np.full(len(nearest), -1, dtype=np.int32)
        face_of_vertex[out_faces.ravel()] = np.repeat(np.arange(len(out_faces), dtype=np.int32), 3)
        self._samples = samples = Samples()
        samples.source, samples.target, samples.barycentric = source, target, self._barycentric
        samples.input_pairs, samples.output_pairs = self.input_pairs, self.output_pairs
        samples.input_count = self._sample_count
        samples.vertex_squared = new_arrays.empty(target.points.shape, dtype=wp.float32, device=device)
        samples.vertex_near = new_arrays.empty(target.points.shape, dtype=wp.int32, device=device)
        samples.vertex_face = new_arrays.uploaded(face_of_vertex, dtype=wp.int32, device=device)
        turns_of = (self._turns_of(range(1), count) for count in (self._sample_count, len(self.output_pairs.face)))
        self._place_count = sum(turns.per_key for turns in turns_of) + len(nearest)
        # Where the output was when distances were last measured.
        self._before: wp.array | None = None

    def find(
        self, reach: float, search: bool = False, note: wp.Kernel | None = None, limits: Limits | None = None
    ) -> None:
        """Pair the output as it lies now; points further apart than ``reach`` are no pair.

        With ``search`` a walk that does not end at a partner is followed by a search of the whole surface;
        ``note``, a kernel of :mod:`warpqem.kernels.surface_limits`, then looks at how far samples are.
        """
        key_count = len(self._target.points)
        if not search:
            self._find_samples(range(key_count), reach, 0, 0)
        else:
            for key in range(key_count):
                meshes = self._show(key)
                self._find_samples(range(key, key + 1), reach, *meshes)
                if note is not None:
                    self._measure_vertices(key)
                    self._note(note, key, meshes, limits)
        self._find_lines(reach)
        lists = build_adjacency(self.input_pairs.face, self._face_count)
        self.input_start, self.input_order = lists.start, lists.corner
        if note is not None:
            self._before = new_arrays.clone(self._target.points)
        elif self._before is not None:
            points, arrays = self._target.points, (self._before, self._samples.vertex_squared)
            inputs, outputs = [rows_of(points)], [*map(rows_of, arrays)]
            launch_in_parts(limit_kernels.move_vertices, points.shape, inputs, outputs, device=self._device)

    def note_far(self, note: wp.Kernel, limits: Limits) -> None:
        """Look at samples that are further away than their component may be, as the output lies now.

        Pairs stay as they were found, with a ``note`` at some time. Walks are made anew only where what has moved may
        be too far, and searches in key frames in which one ends there.
        """
        assert self._before is not None
        keys = len(self._target.points)
        beyond = new_arrays.zeros(keys, dtype=wp.int32, device=self._device)
        shape, inputs, outputs = (
            (keys, self._place_count),
            [FIRST_ITEM, self._before, limits],
            [self._samples_of(0), beyond],
        )
        launch_in_parts(limit_kernels.update_distances, shape, inputs, outputs, device=self._device)
        wp.copy(self._before, self._target.points)
        # Where the host would wait for them, it looks at all.
        waits = not device_traits(self._device).in_order
        for key in range(keys) if waits else np.flatnonzero(beyond.numpy()).tolist():
            self._note(note, key, self._show(key), limits)

    def _show(self, key: int) -> tuple[int, int]:
        """Hierarchies of both surfaces in a key frame."""
        for hierarchy, surface in zip(self._hierarchies, (self._source, self._target), strict=True):
            hierarchy.show(surface, key)
        return self._hierarchies[0].id, self._hierarchies[1].id

    def _measure_vertices(self, key: int) -> None:
        """How far the output's vertices are in a key frame, from where they were in the one before."""
        samples = self._samples
        near, squared = samples.vertex_near, samples.vertex_squared
        inputs = [FIRST_ITEM, key, self._source, self._target, self._to_input]
        kernel, count = kernels.measure_vertex_distances, near.shape[1]
        launch_in_parts(kernel, count, inputs, [near, squared], device=self._device)

    def _samples_of(self, key: int, meshes: tuple[int, int] = (0, 0)) -> Samples:
        """What kernels know of the samples in a key frame, with its hierarchies."""
        samples = self._samples
        samples.source_mesh, samples.target_mesh = meshes
        samples.input_turns = self._turns_of(range(key, key + 1), self._sample_count)
        samples.output_turns = self._turns_of(range(key, key + 1), len(self.output_pairs.face))
        return samples

    def _note(self, kernel: wp.Kernel, key: int, meshes: tuple[int, int], limits: Limits | None) -> None:
        """Look at how far samples are in a key frame."""
        # One thread on a CPU: few samples take more than a look.
        launch(kernel, self._place_count, [self._samples_of(key, meshes)], [limits], device=self._device)

    def _find_samples(self, keys: range, reach: float, source_mesh: int, target_mesh: int) -> None:
        """Pair the samples of both surfaces in some key frames; hierarchies of these are 0 for none."""
        surfaces = [reach, self._source, self._target]
        inputs = [*surfaces, self._to_output, target_mesh]
        self._launch(kernels.match_input_samples, keys, self._sample_count, inputs, self.input_pairs)
        inputs = [*surfaces, self._to_input, source_mesh, self._barycentric]
        self._launch(kernels.match_output_samples, keys, len(self.output_pairs.face), inputs, self.output_pairs)

    def _find_lines(self, reach: float) -> None:
        source, target, first = self._source, self._target, self._sample_count
        for on_seams, (half_edges, width) in enumerate(self._lines):
            for is_output, per_edge in enumerate((INPUT_LINE_SAMPLES, OUTPUT_LINE_SAMPLES)):
                half_edge = half_edges[is_output]
                surfaces = [target, source] if is_output else [source, target]
                start = self._to_input if is_output else self._to_output
                count = len(half_edge) * per_edge * self._turns
                inputs = [reach, *surfaces, is_output, on_seams, half_edge, start, per_edge, self._sizes, width, first]
                if count:
                    keys = range(len(source.points))
                    self._launch(kernels.match_line_samples, keys, count, inputs, self.input_pairs)
                first += 2 * count

    def _launch(
        self, kernel: wp.Kernel, keys: range, pair_count: int, inputs: list[object], pairs: kernels.Pairs
    ) -> None:
        """Find those of ``pair_count`` pairs whose turn it is in some key frames."""
        whole = self._turns_of(keys, pair_count)

        def turns(part: slice) -> kernels.Turns:
            return self._turns_of(keys, pair_count, part.start)

        launch_in_parts(kernel, len(keys) * whole.per_key, [PerPart(turns), *inputs], [pairs], device=self._device)

    def _turns_of(self, keys: range, pair_count: int, first: int = 0) -> kernels.Turns:
        """Which of ``pair_count`` pairs are found in some key frames, from the ``first`` one on."""
        key_count = len(self._source.points)
        # As many as the first frame has; the kernel leaves out those past the end.
        per_key = -(-pair_count // (key_count * self._turns)) * self._turns
        return _turns(first, self._turns, keys.start, key_count, per_key, device_traits(self._device).in_order)


@functools.lru_cache(maxsize=256)
def _turns(first: int, count: int, key: int, key_count: int, per_key: int, prefetches: bool) -> kernels.Turns:
    """Kept, as it takes longer to make than a launch on a small mesh: nobody changes it."""
    turns = kernels.Turns()
    turns.first, turns.count, turns.key, turns.key_count = first, count, key, key_count
    turns.per_key, turns.prefetches = per_key, int(prefetches)
    return turns


class _Hierarchy:
    """The search hierarchy of a moving mesh: built once, then fitted to one frame after the other."""

    def __init__(self, surface: Surface) -> None:
        # A mesh keeps its points, and they change from frame to frame.
        self._mesh = wp.Mesh(points=new_arrays.clone(new_arrays.row(surface.points, 0)), indices=surface.corner_vertex)

    @property
    def id(self) -> int:
        """What kernels know it by."""
        return int(self._mesh.id)

    def show(self, surface: Surface, key: int) -> None:
        """Fit it to a frame of a surface of the same faces."""
        new_arrays.copy(self._mesh.points, new_arrays.row(surface.points, key))
        self._mesh.refit()


def _line_samples(half_edges: Sequence[wp.array]) -> tuple[int, int]:
    """Samples on the borders or seams of the input, and on those of the output."""
    return len(half_edges[0]) * INPUT_LINE_SAMPLES, len(half_edges[1]) * OUTPUT_LINE_SAMPLES


def _empty_pairs(count: int, device: str) -> kernels.Pairs:
    pairs = kernels.Pairs()
    # Lists by face take them in threes.
    pairs.face = new_arrays.full(-(-count // 3) * 3, -1, dtype=wp.int32, device=device)
    pairs.key = new_arrays.empty(count, dtype=wp.int32, device=device)
    pairs.barycentric = new_arrays.empty(count, dtype=wp.vec3, device=device)
    pairs.normal = new_arrays.empty(count, dtype=wp.vec3, device=device)
    pairs.residual = new_arrays.empty(count, dtype=wp.float32, device=device)
    pairs.weight = new_arrays.empty(count, dtype=wp.float32, device=device)
    pairs.near = new_arrays.full(count, -1, dtype=wp.int32, device=device)
    pairs.squared = new_arrays.zeros(count, dtype=wp.float32, device=device)
    return pairs
