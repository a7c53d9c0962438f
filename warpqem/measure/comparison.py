"""Comparison of a simplified mesh sequence with its reference."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from warpqem.device import on_device, resolve_device
from warpqem.measure.binding import bind, check_vertex_map
from warpqem.measure.distance import Closest, ClosestPointSearch
from warpqem.measure.inputs import MeshSequence, check_same_frame_count, check_sequence, chosen_frames, frame_scale
from warpqem.measure.sampling import MaterialSamples, draw_material_samples, normals_and_areas, place
from warpqem.measure.temporal import SecondDifference, binding_errors, in_face_frame
from warpqem.measure.topology import Topology, topology
from warpqem.number_input import check_function, whole_number

__all__ = ["Comparison", "FrameErrors", "compare"]

# Jitter is taken over one second at the usual 24 frames per second, in the middle of the sequence, where the motion is
# under way, and from so many samples that its sampling error is about 1 %.
JITTER_WINDOW = 24
JITTER_SAMPLES = 10000

# A face with less area than this fraction of the squared diagonal has no normal that means anything.
DEGENERATE_AREA = 1e-14


@dataclass(frozen=True)
class FrameErrors:
    """Errors per evaluated frame, arrays of shape (K,); distances in % of the reference's diagonal in that frame.

    Where the nearest point lies on an edge, its faces are equally near and any of them may count as the nearest: normal
    deviation and flips carry that uncertainty (about 0.05 % and 1 %), distances do not.

    Attributes:
        frame: frame indices, int64.
        hausdorff: largest distance of a sample or vertex, both directions.
        mean: average of the mean distances of the two directions.
        rms: larger of the root mean square distances of the two directions.
        rms_forward: root mean square distance from the reference to the test mesh.
        rms_backward: root mean square distance from the test to the reference mesh.
        normal_deviation: mean angle in degrees between a sample's face normal and that of the nearest face, averaged
            over both directions.
        flips: test faces whose normal opposes that of the reference face nearest to their centroid, int64.
        degenerate_faces: test faces with less area than 1e-14 squared diagonals, int64.
    """

    frame: npt.NDArray[np.int64]
    hausdorff: npt.NDArray[np.float64]
    mean: npt.NDArray[np.float64]
    rms: npt.NDArray[np.float64]
    rms_forward: npt.NDArray[np.float64]
    rms_backward: npt.NDArray[np.float64]
    normal_deviation: npt.NDArray[np.float64]
    flips: npt.NDArray[np.int64]
    degenerate_faces: npt.NDArray[np.int64]


@dataclass(frozen=True)
class Comparison:
    """Quality of a test mesh sequence against a reference.

    Attributes:
        per_frame: errors of the evaluated frames.
        rms: mean over the frames of per_frame.rms, in %.
        hausdorff: largest over the frames, in %.
        mean: mean over the frames, in %.
        normal_deviation: mean over the frames, in degrees.
        flips: mean number of flipped faces per frame.
        jitter: root mean square second temporal difference of the offset vectors from reference samples to the test
            mesh, in the frame of the reference face, in % of the mean diagonal; None below three frames.
        slide: the same of the test vertices' offsets from their material points, see `warpqem.measure.binding`.
        slide_p95: the 95th percentile over the test vertices, each with its root mean square over time.
        edge_length_error: root mean square relative error of test edges against the edges between bound points, in %.
        reference_topology: validity figures of the reference faces.
        test_topology: validity figures of the test faces.
        frame_count: frames of the sequences (per_frame may hold fewer).
        sample_count: samples per mesh.
    """

    per_frame: FrameErrors
    rms: float
    hausdorff: float
    mean: float
    normal_deviation: float
    flips: float
    jitter: float | None
    slide: float | None
    slide_p95: float | None
    edge_length_error: float
    reference_topology: Topology
    test_topology: Topology
    frame_count: int
    sample_count: int

    def to_dict(self) -> dict[str, Any]:
        """Plain dictionaries, lists, numbers and None, ready for JSON."""
        result = asdict(self)
        result["per_frame"] = {key: value.tolist() for key, value in result["per_frame"].items()}
        return result


class _FrameComparison:
    """Distances between the frames of two sequences."""

    def __init__(self, reference: MeshSequence, test: MeshSequence, samples: int, seed: int, device: str) -> None:
        self.reference, self.test = reference, test
        self.centre, self.diagonal = frame_scale(reference)
        self.reference_samples = draw_material_samples(reference, samples, seed, "reference")
        self.test_samples = draw_material_samples(test, samples, seed + 1, "test")
        self.to_reference = ClosestPointSearch(reference.faces, device, "reference")
        self.to_test = ClosestPointSearch(test.faces, device, "test")

    def scaled(self, mesh: MeshSequence, frame: int) -> npt.NDArray[np.float64]:
        """Points of one frame with the reference's box at the origin and of unit diagonal."""
        return (mesh.points[frame] - self.centre[frame]) / self.diagonal[frame]

    def errors(self, frame: int) -> tuple[dict[str, Any], Closest]:
        """Errors of one frame by the names of FrameErrors, and the test points closest to the reference samples."""
        reference, test = self.reference, self.test
        p, q = self.scaled(reference, frame), self.scaled(test, frame)
        samples_p, samples_q = self.reference_samples, self.test_samples
        count = len(samples_p.face)
        forward = self.to_test.closest(
            q,
            np.concatenate([place(p, reference.faces, samples_p.face, samples_p.barycentric), p[reference.used]]),
            frame,
        )
        centroids = q[test.faces].mean(axis=1)
        backward = self.to_reference.closest(
            p,
            np.concatenate([place(q, test.faces, samples_q.face, samples_q.barycentric), q[test.used], centroids]),
            frame,
        )
        normals_p, areas_p = normals_and_areas(p, reference.faces)
        normals_q, areas_q = normals_and_areas(q, test.faces)
        ahead, back = forward.part(0, count), backward.part(0, count)
        one = _one_way(ahead, samples_p, areas_p, normals_p, normals_q)
        two = _one_way(back, samples_q, areas_q, normals_q, normals_p)
        distances_back = backward.distance[: count + len(test.used)]
        nearest_normals = normals_p[backward.face[count + len(test.used) :]]
        live = areas_q > DEGENERATE_AREA
        opposed = (normals_q * nearest_normals).sum(axis=1) < 0
        errors = {
            "frame": frame,
            "hausdorff": 100 * max(forward.distance.max(), distances_back.max()),
            "mean": 100 * (one["mean"] + two["mean"]) / 2,
            "rms": 100 * max(one["rms"], two["rms"]),
            "rms_forward": 100 * one["rms"],
            "rms_backward": 100 * two["rms"],
            "normal_deviation": (one["angle"] + two["angle"]) / 2,
            "flips": int((opposed & live).sum()),
            "degenerate_faces": int((~live).sum()),
        }
        return errors, ahead

    def closest_to_samples(self, frame: int, count: int) -> Closest:
        """Test points of one frame closest to the first reference samples."""
        samples = self.reference_samples
        queries = place(
            self.scaled(self.reference, frame), self.reference.faces, samples.face[:count], samples.barycentric[:count]
        )
        return self.to_test.closest(self.scaled(self.test, frame), queries, frame)

    def offsets(self, frame: int, closest: Closest) -> npt.NDArray[np.float64]:
        """Vectors from the first reference samples to their closest test points, in the reference faces' frames."""
        samples, count = self.reference_samples, len(closest.face)
        p, t, face = self.reference.points[frame], self.reference.faces, samples.face[:count]
        target = place(self.test.points[frame], self.test.faces, closest.face, closest.barycentric)
        return in_face_frame(target - place(p, t, face, samples.barycentric[:count]), p, t, face)


def _one_way(
    closest: Closest,
    samples: MaterialSamples,
    areas: npt.NDArray[np.float64],
    normals: npt.NDArray[np.float64],
    other_normals: npt.NDArray[np.float64],
) -> dict[str, float]:
    """Area-weighted mean and root mean square distance, and mean angle in degrees, of the samples of one mesh."""
    weight = samples.weights(areas)  # summed by NumPy, not BLAS, whose result depends on its number of threads
    cosine = (normals[samples.face] * other_normals[closest.face]).sum(axis=1)
    return {
        "mean": float((weight * closest.distance).sum()),
        "rms": float(np.sqrt((weight * closest.distance**2).sum())),
        "angle": float((weight * np.degrees(np.arccos(cosine.clip(-1, 1)))).sum()),
    }


def _measure_frames(
    comparison: _FrameComparison,
    frames: int | Sequence[int] | None,
    progress: Callable[[int, int], None] | None,
) -> tuple[FrameErrors, float | None]:
    """Errors of the chosen frames, and the jitter over the middle ones in % of the mean diagonal."""
    frame_count = len(comparison.reference.points)
    distance_frames = set(chosen_frames(frames, frame_count).tolist())
    first = max(0, (frame_count - JITTER_WINDOW) // 2)
    jitter_frames = range(first, min(frame_count, first + JITTER_WINDOW)) if frame_count > 2 else range(0)
    jitter = SecondDifference()
    rows: list[dict[str, Any]] = []
    todo = sorted(distance_frames.union(jitter_frames))
    for done, frame in enumerate(todo, start=1):
        if frame in distance_frames:
            errors, closest = comparison.errors(frame)
            rows.append(errors)
            closest = closest.part(0, JITTER_SAMPLES)
        else:
            closest = comparison.closest_to_samples(frame, JITTER_SAMPLES)
        if frame in jitter_frames:
            jitter.add(comparison.offsets(frame, closest))
        if progress is not None:
            progress(done, len(todo))
    per_frame = FrameErrors(**{f.name: np.array([row[f.name] for row in rows]) for f in fields(FrameErrors)})
    value = jitter.root_mean_square()
    return per_frame, None if value is None else 100 * value / float(comparison.diagonal.mean())


@on_device
def compare(
    reference_points: npt.ArrayLike,
    reference_faces: npt.ArrayLike,
    test_points: npt.ArrayLike,
    test_faces: npt.ArrayLike,
    *,
    samples: int = 50000,
    seed: int = 0,
    frames: int | Sequence[int] | None = None,
    device: str | None = None,
    vertex_map: npt.ArrayLike | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Comparison:
    """Measure a test mesh sequence against a reference.

    Both surfaces are sampled with material points: the same faces and barycentric coordinates in every frame, drawn by
    the face areas averaged over the frames and weighted by each frame's areas. Vertices count for the Hausdorff
    distance only. As in Cignoni, Rocchini and Scopigno, "Metro: Measuring Error on Simplified Surfaces" (1998), both
    directions are taken. Equal arguments give equal bits.

    Args:
        reference_points: (F, V, 3) or (V, 3).
        reference_faces: (N, 3) integers.
        test_points: (F, V', 3) or (V', 3), with as many frames.
        test_faces: (N', 3) integers.
        samples: samples per mesh, at least 1.
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
        DegenerateMeshError: a mesh has no face, or no extent or area in some frame.
        OptionError: samples, seed or frames out of range.
        DeviceError: there is no such device.
    """
    samples = whole_number(samples, "samples")
    seed = whole_number(seed, "seed", least=0)
    check_function(progress, "progress")
    reference = check_sequence(reference_points, reference_faces, "reference")
    test = check_sequence(test_points, test_faces, "test")
    check_same_frame_count(reference, test)
    device = resolve_device(device)
    comparison = _FrameComparison(reference, test, samples, seed, device)
    per_frame, jitter = _measure_frames(comparison, frames, progress)
    record = None if vertex_map is None else check_vertex_map(vertex_map, reference, test)
    binding = bind(reference, test, comparison.centre, comparison.diagonal, device, record)
    bound = binding_errors(reference, test, binding, comparison.diagonal)
    return Comparison(
        per_frame=per_frame,
        rms=float(per_frame.rms.mean()),
        hausdorff=float(per_frame.hausdorff.max()),
        mean=float(per_frame.mean.mean()),
        normal_deviation=float(per_frame.normal_deviation.mean()),
        flips=float(per_frame.flips.mean()),
        jitter=jitter,
        slide=bound.slide,
        slide_p95=bound.slide_p95,
        edge_length_error=bound.edge_length_error,
        reference_topology=topology(reference.faces),
        test_topology=topology(test.faces),
        frame_count=len(reference.points),
        sample_count=samples,
    )
