"""The measured errors of a simplified mesh: the same figures in results, tables, JSON and pages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from warpqem.arguments.json_types import Json
from warpqem.errors import DegenerateMeshError
from warpqem.frames.stream import FrameSink, FrameSource
from warpqem.measure.cells import Joined
from warpqem.measure.surfaces import SurfaceComparison, sample_count
from warpqem.measure.verdict import Verdict, verdict_of
from warpqem.runtime.device import device_turn

__all__ = [
    "ERRORS",
    "FrameReader",
    "Measured",
    "MeasuringSink",
    "StillPair",
    "first_frames",
    "joined_errors",
    "measure_frames",
    "measure_together",
    "measured_errors",
]


@dataclass(frozen=True)
class Measured:
    """The measured errors of a simplified mesh, over all its frames; distances in % of the reference's diagonal.

    The diagonal is that of the bounding box in each frame. Forward is from the reference to the simplified mesh,
    backward from the simplified mesh to the reference.

    Attributes:
        rms: mean over the frames of the larger root mean square distance of the two directions.
        rms_forward: mean over the frames of the root mean square distance forward.
        rms_backward: the same backward.
        hausdorff: largest distance of any point of either surface from the other, in any frame. Of no point is it
            larger: it is searched for by branch and bound, and at most 0.1 % above the distance of a point.
        mean: mean over the frames of the average of the two mean distances.
        normal_deviation: mean angle in degrees between the normals of a sample's face and of the nearest face.
        flips: mean number, over the frames, of simplified faces that oppose the reference face nearest to their middle.
            Both sides of a sheet, and faces of mixed winding, are opposed by nothing.
        rms_length: mean over the frames of the root mean square distance, in units of the points.
        hausdorff_length: what no distance is above, in units of the points: ``hausdorff`` of the largest diagonal.
        sample_count: samples on each surface in each frame.
        frame_count: frames that were measured.
        test_faces: faces of the simplified mesh.
        collapsed_frames: frames, counted from 0, in which either mesh is collapsed to a point or a line. They are left
            out of all other figures but the largest distance, which is relative to the largest diagonal there.
    """

    rms: float
    rms_forward: float
    rms_backward: float
    hausdorff: float
    mean: float
    normal_deviation: float
    flips: float
    rms_length: float
    hausdorff_length: float
    sample_count: int
    frame_count: int
    test_faces: int
    collapsed_frames: tuple[int, ...]

    @property
    def verdict(self) -> Verdict:
        """Good, look or poor, and why; see :mod:`warpqem.measure.verdict`."""
        return verdict_of(self)

    def to_dict(self) -> dict[str, Json]:
        """Plain dictionaries, numbers and text, ready for JSON."""
        frames: list[Json] = list(self.collapsed_frames)
        verdict = self.verdict
        return {**asdict(self), "collapsed_frames": frames, "verdict": verdict.word, "reason": verdict.reason}


# What is measured of any mesh.
ERRORS = tuple(entry.name for entry in fields(Measured))


def joined_errors(parts: Sequence[Measured]) -> Measured:
    """The errors of a sequence from those of its parts, which follow one another; each may have its own topology."""
    weight = np.array([part.frame_count for part in parts], dtype=np.float64)

    def mean(name: str) -> float:
        return float(np.average([getattr(part, name) for part in parts], weights=weight))

    means = ("rms", "rms_forward", "rms_backward", "mean", "normal_deviation", "flips", "rms_length")
    largest = ("hausdorff", "hausdorff_length", "sample_count", "test_faces")
    return Measured(
        **{name: mean(name) for name in means},  # type: ignore[arg-type]  # names of fields that are float
        **{name: max(getattr(part, name) for part in parts) for name in largest},
        frame_count=sum(part.frame_count for part in parts),
        collapsed_frames=tuple(
            start + frame
            for part, start in zip(parts, first_frames(parts), strict=True)
            for frame in part.collapsed_frames
        ),
    )


def first_frames(parts: Sequence[Measured]) -> list[int]:
    """The number of each part's first frame in the sequence of parts of which all frames were looked at."""
    counts = [part.frame_count + len(part.collapsed_frames) for part in parts]
    return np.cumsum([0, *counts[:-1]]).tolist()


def measured_errors(comparison: SurfaceComparison, mesh: int = 0) -> Measured:
    """The errors over all frames of a comparison that is done; of one of its meshes.

    Raises:
        DegenerateMeshError: a mesh is collapsed to a point or a line in all of them.
    """
    frames, diagonal = comparison.per_frame(mesh), comparison.diagonals(mesh)
    # A frame in which the reference is a point has no size of its own.
    apart = 100.0 * max(comparison.collapsed.values(), default=0.0) / float(diagonal.max())
    hausdorff = max(comparison.largest(mesh), apart)
    return Measured(
        rms=float(frames.rms.mean()),
        rms_forward=float(frames.rms_forward.mean()),
        rms_backward=float(frames.rms_backward.mean()),
        hausdorff=hausdorff,
        mean=float(frames.mean.mean()),
        normal_deviation=float(frames.normal_deviation.mean()),
        flips=float(frames.flips.mean()),
        rms_length=float((frames.rms * diagonal).mean()) / 100.0,
        hausdorff_length=hausdorff * float(diagonal.max()) / 100.0,
        sample_count=comparison.sample_count,
        frame_count=len(frames.frame),
        test_faces=int(comparison.test_faces[mesh]),
        collapsed_frames=tuple(comparison.collapsed),
    )


class FrameReader(Protocol):
    """What frames are read from: a :class:`warpqem.FrameSource` is one."""

    def read(self, frames: slice) -> npt.NDArray[Any]:
        """Points (n, V, 3) of consecutive frames."""
        ...


def measure_frames(
    reference: FrameReader,
    reference_faces: npt.NDArray[np.integer],
    test: FrameReader,
    test_faces: npt.NDArray[np.integer],
    frames: Sequence[int],
    *,
    samples: int | None = None,
    seed: int = 0,
    device: str,
    progress: Callable[[int, int], None] | None = None,
    overall: bool = False,
) -> SurfaceComparison:
    """Measure a mesh against its reference, reading a group of frames at a time.

    Args:
        reference: frames of the reference.
        reference_faces: (N, 3).
        test: frames of the test mesh.
        test_faces: (M, 3).
        frames: ascending numbers of the frames to measure.
        samples: samples on each surface in each frame; None for as many as suit the numbers of frames and faces.
        seed: seed of the samples.
        device: Warp device.
        progress: called with the number of frames done, and of all.
        overall: see :class:`SurfaceComparison`.

    Raises:
        DegenerateMeshError: all faces of a mesh are too thin in a frame.
    """
    if samples is None:
        samples = sample_count(len(frames), max(len(reference_faces), len(test_faces)))
    meshes = Joined.single(reference_faces), Joined.single(test_faces)
    comparison = SurfaceComparison(*meshes, len(frames), samples, seed, device, overall=overall)
    for first in range(0, len(frames), comparison.group):
        some = frames[first : first + comparison.group]
        if some[-1] - some[0] == len(some) - 1:
            points = [mesh.read(slice(some[0], some[-1] + 1)) for mesh in (reference, test)]
        else:
            points = [np.concatenate([mesh.read(slice(f, f + 1)) for f in some]) for mesh in (reference, test)]
        comparison.add(some, *points)
        if progress is not None:
            progress(first + len(some), len(frames))
    return comparison


@dataclass(frozen=True)
class StillPair:
    """A mesh in one frame, and what it is measured against.

    Attributes:
        reference: (1, V, 3) points of the reference.
        reference_faces: (N, 3).
        test: (1, W, 3) points of the test mesh.
        test_faces: (M, 3).
        frame: the number of the frame.
    """

    reference: npt.NDArray[Any]
    reference_faces: npt.NDArray[np.integer]
    test: npt.NDArray[Any]
    test_faces: npt.NDArray[np.integer]
    frame: int

    @property
    def samples(self) -> int:
        """Samples on each of the two surfaces."""
        return sample_count(1, max(len(self.reference_faces), len(self.test_faces)))


def measure_together(pairs: Sequence[StillPair], *, device: str) -> list[Measured | DegenerateMeshError]:
    """The errors of each of several pairs of meshes, as :func:`measure_frames` gives them of one alone, to the bit.

    Small meshes take the host longer than the device, and many together hardly longer than one.

    Args:
        pairs: meshes of as many samples, and of one number of the frame.
        device: Warp device.

    Returns:
        The errors of each, or why there are none.
    """
    try:
        sides = (
            ([pair.reference for pair in pairs], [pair.reference_faces for pair in pairs]),
            ([pair.test for pair in pairs], [pair.test_faces for pair in pairs]),
        )
        joined = [Joined.of(faces, [points.shape[1] for points in given]) for given, faces in sides]
        first = pairs[0]
        comparison = SurfaceComparison(joined[0], joined[1], 1, first.samples, 0, device, overall=True)
        comparison.add([first.frame], *(np.concatenate(given, axis=1) for given, _ in sides))
        return [measured_errors(comparison, mesh) for mesh in range(len(pairs))]
    except DegenerateMeshError as error:
        if len(pairs) == 1:
            return [error]
        # One has no errors, or only a distance: the others have no part in it.
        return [found for pair in pairs for found in measure_together([pair], device=device)]


class MeasuringSink:
    """Passes frames on, and measures them against the input on their way.

    Args:
        sink: takes the frames.
        source: frames of the input, which are read once more.
        faces: (N, 3) faces of the input.
        device: Warp device.
    """

    def __init__(self, sink: FrameSink, source: FrameSource, faces: npt.NDArray[np.int32], device: str) -> None:
        self._sink, self._source, self._faces, self._device = sink, source, faces, device
        self._comparison: SurfaceComparison | None = None
        # Frames of the input and of the result that do not fill a group yet.
        self._waiting: tuple[npt.NDArray[Any], npt.NDArray[np.float32]] | None = None
        self._done = self._frame_count = 0

    def begin(self, frame_count: int, vertex_count: int, faces: npt.NDArray[np.int32]) -> None:
        """Begin a mesh of so many frames."""
        self._sink.begin(frame_count, vertex_count, faces)
        self._frame_count, self._done, self._waiting = frame_count, 0, None
        samples = sample_count(frame_count, max(len(self._faces), len(faces)))
        with device_turn(self._device):
            meshes = Joined.single(self._faces), Joined.single(faces)
            self._comparison = SurfaceComparison(*meshes, frame_count, samples, 0, self._device, overall=True)

    def write(self, frames: slice, points: npt.NDArray[np.float32]) -> None:
        """Pass on consecutive frames, and measure those that fill a group; what is left waits for the next call."""
        self._sink.write(frames, points)
        assert self._comparison is not None
        pair = (self._source.read(frames), points)
        if self._waiting is not None:
            before, after = self._waiting
            pair = (np.concatenate([before, pair[0]]), np.concatenate([after, pair[1]]))
        group = self._comparison.group
        while len(pair[1]) >= group or (len(pair[1]) and frames.stop == self._frame_count):
            reference, some = (mesh[:group] for mesh in pair)
            with device_turn(self._device):
                self._comparison.add(range(self._done, self._done + len(some)), reference, some)
            self._done += len(some)
            pair = (pair[0][group:], pair[1][group:])
        self._waiting = (pair[0].copy(), pair[1].copy()) if len(pair[1]) else None

    def measured(self, result: Any = None) -> Measured:
        """The errors, when all frames have been written; of the result whose frames these were."""
        assert self._comparison is not None
        with device_turn(self._device):
            return measured_errors(self._comparison)
