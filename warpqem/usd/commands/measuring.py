"""Measure meshes of an output against those of the input."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt
from pxr import Usd

from warpqem.arguments.distance_limit import DistanceLimit
from warpqem.errors import WarpqemError
from warpqem.frames.stream import FrameSource, SomeFrames, counted_frames
from warpqem.measure import Measured
from warpqem.measure.measured import StillPair, measure_frames, measure_together, measured_errors
from warpqem.measure.surfaces import SMALL_FACES
from warpqem.runtime.device import device_turn
from warpqem.usd.commands.context import Progress
from warpqem.usd.commands.mesh_job import MeshJob
from warpqem.usd.commands.skin_bound import is_within, largest_diagonal
from warpqem.usd.read.read_mesh import MeshSource, PoseFrames
from warpqem.usd.read.skeleton_poses import StagePoses
from warpqem.usd.write.stage_report import PrimReport, collapsed_note, name_prim

__all__ = ["MAX_TOGETHER", "WrittenMeasures", "written_source", "written_within"]

# Small meshes of a group, which are measured together: some 500 KB each.
MAX_TOGETHER = 128


@dataclass(frozen=True)
class _Waiting:
    """A small mesh that was written, and its report."""

    job: MeshJob
    report: PrimReport
    pair: StillPair


class WrittenMeasures:
    """Measures meshes that were written, and notes the errors in their reports.

    They are those that `warpqem compare` gives for the input and the output. Small meshes in one frame wait for each
    other, and are measured together with the same results: alone each takes the host longer than the device.

    Args:
        device: Warp device; None for the default.
    """

    def __init__(self, device: str | None) -> None:
        """Start with none that waits."""
        self._device = device
        self._waiting: list[_Waiting] = []

    @property
    def is_full(self) -> bool:
        """Whether as many wait as are to be measured together."""
        return len(self._waiting) >= MAX_TOGETHER

    def add(
        self, job: MeshJob, stage: Usd.Stage, report: PrimReport, progress: Progress, *, waits: bool = True
    ) -> None:
        """Measure a mesh, or read a small one that waits, as the stage of the edits shows it.

        Frames are read a few at a time. Where a mesh cannot be measured, the report says why.

        Args:
            job: The mesh as it was read.
            stage: The input with the edits.
            report: What happened to the mesh.
            progress: Called with the part done.
            waits: Whether the errors have time until :meth:`finish`.
        """
        try:
            test, test_faces = _written(job, stage)
            reference, faces = _reference(job)
            frames = np.flatnonzero(counted_frames(reference)).tolist()
            progress(0.0, "measure")
            if waits and len(frames) == 1 and max(len(faces), len(test_faces)) <= SMALL_FACES:
                one = slice(frames[0], frames[0] + 1)
                pair = StillPair(reference.read(one), faces, test.read(one), test_faces, frames[0])
                self._waiting.append(_Waiting(job, report, pair))
                return
            with device_turn(self._device) as used:
                done = measure_frames(
                    reference,
                    faces,
                    test,
                    test_faces,
                    frames,
                    device=used,
                    progress=lambda done, total: progress(done / total, "measure"),
                    overall=True,
                )
                _note(job, report, measured_errors(done))
        except WarpqemError as error:
            _note(job, report, error)

    def finish(self, alone: Callable[[str, Callable[[], None]], None]) -> None:
        """Measure those that wait.

        Args:
            alone: Called with the path of a mesh and what measures it, where an error that nobody foresees is one of
                several: it is the matter of one mesh. Adds the time that it takes to the report.
        """
        waiting = [one for one in self._waiting if one.report.status == "simplified"]
        self._waiting = []
        for _, group in itertools.groupby(waiting, lambda one: one.pair.frame):
            some, start = list(group), time.perf_counter()
            try:
                self._measure(some)
            except Exception:
                for one in some:
                    alone(one.report.path, partial(self._measure, [one]))
                continue
            seconds = (time.perf_counter() - start) / len(some)
            for one in some:
                one.report.seconds += seconds

    def _measure(self, waiting: list[_Waiting]) -> None:
        with device_turn(self._device) as used:
            found = measure_together([one.pair for one in waiting], device=used)
        for one, measured in zip(waiting, found, strict=True):
            _note(one.job, one.report, measured)


def _note(job: MeshJob, report: PrimReport, found: Measured | WarpqemError) -> None:
    """Note the errors of a mesh, or why there are none."""
    if isinstance(found, WarpqemError):
        report.problems.append(f"not measured: {name_prim(job.mesh.path, found)}")
        return
    report.measured = found.to_dict()
    if found.collapsed_frames:
        report.notes.append(collapsed_note(job.mesh.path, job.mesh.times, found.collapsed_frames))


def written_within(job: MeshJob, stage: Usd.Stage, limit: DistanceLimit, device: str | None) -> bool:
    """Whether a mesh that was written is proved to be within a limit of the mesh as it was read, in all its poses."""
    test, test_faces = _written(job, stage)
    reference, faces = _reference(job)
    return is_within(reference, faces, test, test_faces, limit, largest_diagonal(job), device)


class _NoPoses(StagePoses):
    """Poses of a mesh that nothing deforms, which need no look at the whole stage."""

    def __init__(self) -> None:
        """Know of no binding."""
        self._bindings = {}


def written_source(stage: Usd.Stage, job: MeshJob) -> MeshSource:
    """A mesh as the stage of the edits shows it."""
    poses = _NoPoses() if job.skin is None else StagePoses(stage)
    return MeshSource(stage.GetPrimAtPath(job.mesh.path), poses)


def _written(job: MeshJob, stage: Usd.Stage) -> tuple[FrameSource, npt.NDArray[np.int32]]:
    """The poses of a mesh and its faces, counter-clockwise, as the stage of the edits shows it."""
    source = written_source(stage, job)
    layout = source.layout(job.mesh.times)
    return PoseFrames(source, job.mesh.times, layout.used_points), layout.right_handed_faces


def _reference(job: MeshJob) -> tuple[FrameSource, npt.NDArray[np.int32]]:
    """The poses of a mesh and its faces, counter-clockwise; those that are in memory already, where these are they."""
    poses = SomeFrames(job.frames, job.pose_start, job.frames.frame_count)
    if job.has_own_poses:
        faces = np.ascontiguousarray(job.faces[:, ::-1]) if job.mesh.left_handed else job.faces
        return poses, faces
    return PoseFrames(job.source, job.mesh.times, job.mesh.used_points), job.mesh.right_handed_faces
