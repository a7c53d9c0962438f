"""Measure a mesh of an output against that of the input."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pxr import Usd

from warpqem.arguments.distance_limit import DistanceLimit
from warpqem.errors import WarpqemError
from warpqem.frames.stream import FrameSource, SomeFrames, counted_frames
from warpqem.measure import Measured
from warpqem.measure.measured import measure_frames, measured_errors
from warpqem.runtime.device import device_turn
from warpqem.usd.commands.context import Progress
from warpqem.usd.commands.mesh_job import MeshJob
from warpqem.usd.commands.skin_bound import is_within, largest_diagonal
from warpqem.usd.read.read_mesh import MeshSource, PoseFrames
from warpqem.usd.read.skeleton_poses import StagePoses
from warpqem.usd.write.stage_report import PrimReport, collapsed_note, name_prim

__all__ = ["measure_written", "written_source", "written_within"]


def measure_written(job: MeshJob, stage: Usd.Stage, report: PrimReport, device: str | None, progress: Progress) -> None:
    """Measure a mesh that was written, as the stage of the edits shows it, and note the errors in its report.

    They are those that `warpqem compare` gives for the input and the output. Frames are read a few at a time. Where a
    mesh cannot be measured, the report says why.

    Args:
        job: The mesh as it was read.
        stage: The input with the edits.
        report: What happened to the mesh.
        device: Warp device; None for the default.
        progress: Called with the part done.
    """
    try:
        source = written_source(stage, job)
        layout = source.layout(job.mesh.times)
        test = PoseFrames(source, job.mesh.times, layout.used_points)
        reference, faces = _reference(job)
        found = _measure(reference, faces, test, layout.right_handed_faces, device, progress)
        report.measured = found.to_dict()
        if found.collapsed_frames:
            report.notes.append(collapsed_note(job.mesh.path, job.mesh.times, found.collapsed_frames))
    except WarpqemError as error:
        report.problems.append(f"not measured: {name_prim(job.mesh.path, error)}")


def written_within(job: MeshJob, stage: Usd.Stage, limit: DistanceLimit, device: str | None) -> bool:
    """Whether a mesh that was written is proved to be within a limit of the mesh as it was read, in all its poses."""
    source = written_source(stage, job)
    layout = source.layout(job.mesh.times)
    test = PoseFrames(source, job.mesh.times, layout.used_points)
    reference, faces = _reference(job)
    return is_within(reference, faces, test, layout.right_handed_faces, limit, largest_diagonal(job), device)


def _measure(
    reference: FrameSource,
    reference_faces: npt.NDArray[np.int32],
    test: FrameSource,
    test_faces: npt.NDArray[np.int32],
    device: str | None,
    progress: Progress,
) -> Measured:
    def show(done: int, total: int) -> None:
        progress(done / total, "measure")

    progress(0.0, "measure")
    with device_turn(device) as used:
        frames = np.flatnonzero(counted_frames(reference)).tolist()
        return measured_errors(
            measure_frames(
                reference, reference_faces, test, test_faces, frames, device=used, progress=show, overall=True
            )
        )


class _NoPoses(StagePoses):
    """Poses of a mesh that nothing deforms, which need no look at the whole stage."""

    def __init__(self) -> None:
        """Know of no binding."""
        self._bindings = {}


def written_source(stage: Usd.Stage, job: MeshJob) -> MeshSource:
    """A mesh as the stage of the edits shows it."""
    poses = _NoPoses() if job.skin is None else StagePoses(stage)
    return MeshSource(stage.GetPrimAtPath(job.mesh.path), poses)


def _reference(job: MeshJob) -> tuple[FrameSource, npt.NDArray[np.int32]]:
    """The poses of a mesh and its faces, counter-clockwise; those that are in memory already, where these are they."""
    poses = SomeFrames(job.frames, job.pose_start, job.frames.frame_count)
    if job.has_own_poses:
        faces = np.ascontiguousarray(job.faces[:, ::-1]) if job.mesh.left_handed else job.faces
        return poses, faces
    return PoseFrames(job.source, job.mesh.times, job.mesh.used_points), job.mesh.right_handed_faces
