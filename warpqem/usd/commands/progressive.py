"""Progressive meshes from and to USD: the poses of one mesh, in world space."""

from __future__ import annotations

import contextlib
import os
import reprlib
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from pxr import Sdf, Usd, UsdGeom, Vt

from warpqem.errors import (
    DegenerateMeshError,
    MemoryLimitError,
    OptionError,
    ProgressiveFileError,
    StageError,
    WarpqemError,
)
from warpqem.files.outputs import InputFile, OutputFile, check_outputs
from warpqem.measure import Measured
from warpqem.options import target_count
from warpqem.progressive import ProgressiveMesh, build_progressive, read_info, save
from warpqem.progressive.bounded_levels import coarsest_within, measured_level
from warpqem.progressive.file import ProgressiveFile
from warpqem.progressive.header import FileInfo
from warpqem.progressive.stage_notes import StageNotes
from warpqem.usd.checks.byte_check import MAX_NESTED
from warpqem.usd.checks.input_files import check_stage_outputs
from warpqem.usd.checks.usd_errors import usd_errors_named
from warpqem.usd.commands.mesh_job import MeshJob
from warpqem.usd.commands.progressive_options import NOT_TO_BUILD, BuildOptions, LevelChoice
from warpqem.usd.commands.simplify_options import SimplifyOptions
from warpqem.usd.read.open_stage import find_meshes, open_stage
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.skeleton_poses import StagePoses
from warpqem.usd.write.layer_files import check_output_path, export_layer

__all__ = ["BuildOptions", "ExtractedLevel", "LevelChoice", "build_file", "extract_level"]

Progress = Callable[[float, str], None]


class ExtractedLevel(NamedTuple):
    """A level that was written.

    Attributes:
        faces: Its triangles.
        estimate: Its error by the estimate of the order, in % of the bounding-box diagonal.
        measured: Its measured errors; None for a level that was taken by its faces.
    """

    faces: int
    estimate: float
    measured: Measured | None


def build_file(
    input_path: str | os.PathLike[str],
    output_path: str | os.PathLike[str],
    options: BuildOptions,
    progress: Progress | None = None,
    other_outputs: Sequence[OutputFile] = (),
) -> FileInfo:
    """Build the progressive mesh of one mesh of a USD file, in all its poses and in world space, and save it.

    Args:
        input_path: USD file.
        output_path: The progressive mesh; replaced if it exists.
        options: What to do.
        progress: Called with the fraction done and what is being done.
        other_outputs: What else the caller is going to write; see `warpqem.usd.simplify_stage`.

    Raises:
        StageError: the input cannot be read, or the output cannot be written.
        OptionError: an option or an output path is wrong, or the stage has more than one mesh and none is chosen.
    """
    stage = open_stage(input_path)
    check_stage_outputs([OutputFile("output", output_path), *other_outputs], [stage])
    # Without its skin, and otherwise as for a whole result.
    reading = SimplifyOptions(ratio=1.0, frames=options.frames, bake=True)
    job = MeshJob.prepare(MeshSource(_one_mesh(stage, options.prim), StagePoses(stage)), reading)
    if not len(job.faces):
        raise StageError(f"{job.mesh.path}: the mesh has no faces")
    points = _in_world(job)
    faces = job.faces[:, ::-1] if job.mesh.left_handed else job.faces
    chosen: dict[str, Any] = {name: value for name, value in options.method().items() if name not in NOT_TO_BUILD}
    mesh = build_progressive(
        points,
        faces,
        base_faces=options.base_faces,
        seams=job.seams.hold(),
        progress=progress,
        **chosen,
    )
    extra = {
        "prim": job.mesh.path,
        "times": job.mesh.times,
        "diagonal": float(np.linalg.norm(np.ptp(points.astype(np.float64), axis=1), axis=1).max()),
        "stage": {
            "up_axis": str(UsdGeom.GetStageUpAxis(stage)),
            "metres_per_unit": UsdGeom.GetStageMetersPerUnit(stage),
            "time_codes_per_second": stage.GetTimeCodesPerSecond(),
            "frames_per_second": stage.GetFramesPerSecond(),
        },
    }
    try:
        save(mesh, output_path, extra)
    except OSError as error:
        raise StageError(f"{output_path}: cannot be written ({error.strerror})") from error
    return read_info(output_path)


def extract_level(
    input_path: str | os.PathLike[str],
    output_path: str | os.PathLike[str],
    choice: LevelChoice,
    memory: int | str | None = None,
    other_outputs: Sequence[OutputFile] = (),
    device: str | None = None,
) -> ExtractedLevel:
    """Write one level of a progressive mesh as a USD file of its own, and read no more of it than that takes.

    A level by a limit takes all of the file, as it is proved to be within the limit of the input.

    Args:
        input_path: The progressive mesh; one from anywhere is safe to read.
        output_path: .usd, .usda or .usdc file; replaced if it exists.
        choice: Which level.
        memory: What the mesh may take, see `warpqem.progressive.load`.
        other_outputs: What else the caller is going to write; see `warpqem.usd.simplify_stage`.
        device: Warp device; None for the default.

    Raises:
        ProgressiveFileError: the input is no progressive mesh, damaged, or takes more memory than it may.
        MemoryLimitError: memory has run out on the way.
        StageError: a file cannot be read or written.
        OptionError: an option or an output path is wrong, or the base mesh has more faces than asked for.
    """
    try:
        output = check_output_path(output_path, [input_path])
        check_outputs([OutputFile("output", output_path), *other_outputs], [InputFile(input_path)])
        with ProgressiveFile(input_path) as file:
            notes = StageNotes(file.path, file.info.extra, file.info.frame_count)
            mesh, split_count = _find_level(file, notes, choice, memory, device)
        level = mesh.level(split_count)
        export_layer(_layer(notes, level.points, level.faces), output)
        measured = None
        if choice.limit(notes):
            with contextlib.suppress(DegenerateMeshError):
                measured = measured_level(mesh, level, device=device)
    except OSError as error:
        raise StageError(f"{input_path}: cannot be read ({error.strerror})") from error
    except MemoryError as error:
        if isinstance(error, WarpqemError):
            raise
        raise MemoryLimitError(f"{input_path}: there is not enough memory to take a level out of it") from error
    return ExtractedLevel(len(level.faces), level.error, measured)


def _one_mesh(stage: Usd.Stage, path: str | None) -> Usd.Prim:
    selection = find_meshes(stage, () if path is None else (path,))
    for _, error in selection.refused:
        raise error
    if not selection.prims:
        raise StageError("there is no mesh on the stage")
    if len(selection.prims) > 1:
        names = ", ".join(str(prim.GetPath()) for prim in selection.prims[:5])
        more = ", ..." if len(selection.prims) > 5 else ""
        raise OptionError(f"there are {len(selection.prims)} meshes ({names}{more}): choose one with --prim")
    return selection.prims[0]


def _in_world(job: MeshJob) -> npt.NDArray[np.float64]:
    """The poses (F, V, 3) as the stage shows them."""
    points = job.frames.read(slice(0, job.frames.frame_count)).astype(np.float64)
    for index, time in enumerate(job.mesh.times or [None]):
        code = Usd.TimeCode.Default() if time is None else Usd.TimeCode(time)
        matrix = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(job.source.prim))
        points[index] = points[index] @ matrix[:3, :3] + matrix[3, :3]
    return points


def _find_level(
    file: ProgressiveFile, notes: StageNotes, choice: LevelChoice, memory: int | str | None, device: str | None
) -> tuple[ProgressiveMesh, int]:
    limit = choice.limit(notes)
    if limit:
        mesh = file.load(memory=memory)
        try:
            return mesh, coarsest_within(mesh, limit, device=device)
        except DegenerateMeshError as error:
            raise ProgressiveFileError(f"{file.path}: {error}") from error
    face_count = file.info.face_count
    target = choice.faces if choice.ratio is None else target_count(choice.ratio, face_count)
    mesh = file.load(target_faces=target, memory=memory)
    return mesh, mesh.splits_for(target_faces=min(target or 0, face_count))


def _prim_path(notes: StageNotes) -> Sdf.Path:
    """The path of the mesh, which USD can make prims of: it trusts the paths that it is handed."""
    text = notes.prim()
    if text.count("/") > MAX_NESTED:
        raise ProgressiveFileError(f"{notes.where}: the prim path in it has more than {MAX_NESTED} names")
    path = Sdf.Path(text) if Sdf.Path.IsValidPathString(text) else Sdf.Path()
    if not (path.IsAbsolutePath() and path.IsPrimPath()) or path.ContainsPrimVariantSelection():
        raise ProgressiveFileError(f"{notes.where}: prim {reprlib.repr(text)} in it is not the path of a prim")
    return path


def _layer(notes: StageNotes, points: npt.NDArray[np.float32], faces: npt.NDArray[np.int32]) -> Sdf.Layer:
    units, times, prim_path = notes.units(), notes.times(), _prim_path(notes)
    layer = Sdf.Layer.CreateAnonymous("level.usdc")
    stage = Usd.Stage.Open(layer)
    with usd_errors_named(f"{notes.where}: prim {prim_path}"):
        UsdGeom.SetStageUpAxis(stage, units.up_axis)
        UsdGeom.SetStageMetersPerUnit(stage, units.metres_per_unit)
        stage.SetTimeCodesPerSecond(units.time_codes_per_second)
        stage.SetFramesPerSecond(units.frames_per_second)
        mesh = UsdGeom.Mesh.Define(stage, prim_path)
        stage.SetDefaultPrim(stage.GetPrimAtPath(prim_path.GetPrefixes()[0]))
        mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, dtype=np.int32)))
        mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(faces.ravel())))
        codes = [Usd.TimeCode.Default()] if times is None else [Usd.TimeCode(time) for time in times]
        if times:
            stage.SetStartTimeCode(times[0])
            stage.SetEndTimeCode(times[-1])
        for code, pose in zip(codes, points, strict=True):
            mesh.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(pose)), code)
            extent = np.stack([pose.min(axis=0), pose.max(axis=0)])
            mesh.CreateExtentAttr().Set(Vt.Vec3fArray.FromNumpy(extent), code)
    return layer
