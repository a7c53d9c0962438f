"""Comparison of a simplified mesh sequence with its reference."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np
import numpy.typing as npt

from warpqem.arguments.json_types import Json
from warpqem.arguments.number_input import check_function, whole_number
from warpqem.frames.stream import ArrayFrames
from warpqem.measure.binding import bind, check_vertex_map
from warpqem.measure.checked_meshes import (
    check_same_frame_count,
    check_sequence,
    chosen_frames,
    frame_scale,
)
from warpqem.measure.closest_points import ClosestPointSearch
from warpqem.measure.collapsed import Standing, standing_frames
from warpqem.measure.measured import Measured, measure_frames, measured_errors
from warpqem.measure.per_frame import FrameErrors
from warpqem.measure.sampling import draw_material_samples, place
from warpqem.measure.temporal import SecondDifference, binding_errors, in_face_frame
from warpqem.measure.validity import Topology, topology
from warpqem.runtime.device import on_device, resolve_device

__all__ = ["Comparison", "FrameErrors", "compare"]

Doubles = npt.NDArray[np.float64]

# Jitter is taken over one second at the usual 24 frames per second, in the middle of the sequence, where the motion is
# under way, and from so many samples that its sampling error is a few percent: a few unsteady samples decide it.
JITTER_WINDOW = 24
JITTER_SAMPLES = 4000


@dataclass(frozen=True)
class Comparison(Measured):
    """Quality of a test mesh sequence against a reference: its measured errors, and what else there is to know.

    Attributes:
        per_frame: errors of the measured frames.
        jitter: root mean square second temporal difference of the offset vectors from reference samples to the test
            mesh, in the frame of the reference face, in % of the mean diagonal; None below three frames.
        slide: the same of the test vertices' offsets from their material points, see `warpqem.measure.binding`.
        slide_p95: the 95th percentile over the test vertices, each with its root mean square over time.
        edge_length_error: root mean square relative error of test edges against the edges between bound points, in %.
        reference_topology: validity figures of the reference faces.
        test_topology: validity figures of the test faces.
    """

    per_frame: FrameErrors
    jitter: float | None
    slide: float | None
    slide_p95: float | None
    edge_length_error: float
    reference_topology: Topology
    test_topology: Topology

    def to_dict(self) -> dict[str, Json]:
        """Plain dictionaries, lists, numbers and None, ready for JSON."""
        frames = {key: value.tolist() for key, value in vars(self.per_frame).items()}
        return {**super().to_dict(), "per_frame": frames}


def _jitter(meshes: Standing, centre: Doubles, diagonal: Doubles, seed: int, device: str) -> float | None:
    """Jitter over the middle frames in % of the mean diagonal; None below three frames that follow one another."""
    reference, test = meshes.reference, meshes.test
    frame_count = len(reference.points)
    if frame_count < 3:
        return None
    first = max(0, (frame_count - JITTER_WINDOW) // 2)
    window = slice(first, min(frame_count, first + JITTER_WINDOW))
    samples = draw_material_samples(reference, JITTER_SAMPLES, seed, "reference")
    search = ClosestPointSearch(test.faces, device, "test")
    jitter = SecondDifference()
    for frame in range(window.start, window.stop):
        if not meshes.follows[frame]:
            jitter.restart()
        p, q = reference.points[frame], test.points[frame]
        scaled = [(points - centre[frame]) / diagonal[frame] for points in (p, q)]
        material = (reference.faces, samples.face, samples.barycentric)
        closest = search.closest(scaled[1], place(scaled[0], *material), frame)
        offset = place(q, test.faces, closest.face, closest.barycentric) - place(p, *material)
        jitter.add(in_face_frame(offset, p, reference.faces, samples.face))
    value = jitter.root_mean_square()
    return None if value is None else 100 * value / float(diagonal.mean())


@on_device
def compare(
    reference_points: npt.ArrayLike,
    reference_faces: npt.ArrayLike,
    test_points: npt.ArrayLike,
    test_faces: npt.ArrayLike,
    *,
    samples: int | None = None,
    seed: int = 0,
    frames: int | Sequence[int] | None = None,
    device: str | None = None,
    vertex_map: npt.ArrayLike | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Comparison:
    """Measure a test mesh sequence against a reference.

    In each frame both surfaces are sampled in proportion to area. As in Cignoni, Rocchini and Scopigno, "Metro:
    Measuring Error on Simplified Surfaces" (1998), both directions are taken. The largest distance is searched for over
    the whole surfaces, see :mod:`warpqem.kernels.largest_distance`. Frames in which either mesh is collapsed to a point
    or a line have no errors, see :attr:`Measured.collapsed_frames`. Equal arguments give equal bits, and the figures of
    :class:`Measured` are those that :func:`warpqem.simplify` gives for its result.

    Args:
        reference_points: (F, V, 3) or (V, 3).
        reference_faces: (N, 3) integers.
        test_points: (F, V', 3) or (V', 3), with as many frames.
        test_faces: (N', 3) integers.
        samples: samples on each surface in each frame, at least 1; None for as many as suit frames and faces: 20000 in
            one frame, fewer in more, 64 in 512 and more, and at most four for each face, or 2000 where that is less.
        seed: seed of the samples, at least 0.
        frames: frames to measure distances on: None for all, a number for so many evenly spread, or a list of indices.
            Jitter always takes the middle 24 frames, slide and edge lengths all.
        device: Warp device name; None takes "cuda:0" where there is one, else "cpu".
        vertex_map: (V,) integers, the test vertex that each reference vertex was collapsed into, -1 for none, as
            `SimplifiedMesh.vertex_map`: slide then follows this record, else it finds the material points by shape.
        progress: called with the number of frames done and the number of frames.

    Raises:
        MeshShapeError: an array has the wrong shape or dtype, the frame counts differ, or ``vertex_map`` does not fit.
        NonFinitePointError: a point is NaN or infinite.
        FaceIndexError: a face refers to a vertex that does not exist.
        DegenerateMeshError: a mesh has no face, or is collapsed to a point or a line in all frames.
        OptionError: samples, seed or frames out of range.
        DeviceError: there is no such device.

    Examples:
        >>> import numpy as np, trimesh, warpqem
        >>> ball = trimesh.creation.icosphere(subdivisions=3)
        >>> points = np.stack([ball.vertices * (1, 1, 1 + 0.2 * step) for step in range(4)])
        >>> result = warpqem.simplify(points, ball.faces, ratio=0.1)
        >>> errors = warpqem.measure.compare(points, ball.faces, result.points, result.faces)
        >>> errors.rms < errors.hausdorff < 2
        True
    """
    samples = None if samples is None else whole_number(samples, "samples")
    seed = whole_number(seed, "seed", least=0)
    check_function(progress, "progress")
    reference = check_sequence(reference_points, reference_faces, "reference")
    test = check_sequence(test_points, test_faces, "test")
    check_same_frame_count(reference, test)
    device = resolve_device(device)
    chosen = chosen_frames(frames, len(reference.points)).tolist()
    standing = standing_frames(reference, test)
    centre, diagonal = frame_scale(standing.reference)
    found = measure_frames(
        ArrayFrames(reference.points),
        reference.faces,
        ArrayFrames(test.points),
        test.faces,
        chosen,
        samples=samples,
        seed=seed,
        device=device,
        progress=progress,
    )
    record = None if vertex_map is None else check_vertex_map(vertex_map, reference, test)
    binding = bind(standing.reference, standing.test, centre, diagonal, device, record)
    bound = binding_errors(standing, binding, diagonal)
    return Comparison(
        **asdict(measured_errors(found)),
        per_frame=found.per_frame(),
        jitter=_jitter(standing, centre, diagonal, seed, device),
        slide=bound.slide,
        slide_p95=bound.slide_p95,
        edge_length_error=bound.edge_length_error,
        reference_topology=topology(reference.faces),
        test_topology=topology(test.faces),
    )
