"""Simplify sequences of mesh files: as a stage that is put together from them, and back to files."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from warpqem.errors import MeshFileError, OptionError
from warpqem.files.outputs import InputFile, OutputFile, check_outputs
from warpqem.files.temporary import remove_path, temporary_path
from warpqem.mesh_files.file_names import find_mesh_files, frame_numbers, is_mesh_name, numbered_files
from warpqem.mesh_files.writing import check_mesh_output
from warpqem.usd.commands.context import Announce, Progress
from warpqem.usd.commands.mesh_stage import export_meshes, mesh_numbers, write_mesh_stage
from warpqem.usd.commands.output_names import output_files
from warpqem.usd.commands.simplify import simplify_stage
from warpqem.usd.commands.simplify_options import SimplifyOptions
from warpqem.usd.write.layer_files import check_output_path
from warpqem.usd.write.package import is_package
from warpqem.usd.write.stage_report import StageReport

__all__ = ["DEFAULT_FPS", "simplify_mesh_files"]

# Frames per second of film, and of USD where nothing is authored.
DEFAULT_FPS = 24.0
# Part of the progress for reading the files.
READ_SHARE = 0.3
# What patterns are written with, which is in the way in names of files.
PATTERN_LETTERS = str.maketrans("", "", "*?#[]")


def simplify_mesh_files(
    pattern: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    output: str | os.PathLike[str],
    options: SimplifyOptions,
    *,
    fps: float = DEFAULT_FPS,
    progress: Progress | None = None,
    announce: Announce | None = None,
    other_outputs: Sequence[OutputFile] = (),
    before_end: Callable[[StageReport], None] | None = None,
) -> StageReport:
    """Simplify mesh files as the frames of one mesh.

    One file is in memory at a time. Beside the output there is a temporary stage of all of them meanwhile.

    Args:
        pattern: The files, see `warpqem.load`.
        output: A USD file, which holds all frames; or mesh files, such as "out/horse_####.ply", with the numbers of the
            input. Files that are there are replaced, but never one that is read.
        options: What to do. Levels of detail need `lod_files`, or a package.
        fps: Time codes per second; the numbers of the files are the time codes.
        progress: Called with the part done and what is being done.
        announce: See `warpqem.usd.simplify_stage`.
        other_outputs: See there.
        before_end: Called with the report, in which `input` is the temporary stage then.

    Returns:
        The report; its `problems` begin with what was found in the files.

    Raises:
        MeshFileError: a file cannot be read or written, or has other faces than the first one.
        OptionError, StageError, DeviceError: see `warpqem.usd.simplify_stage`.
    """
    if not 0 < fps < float("inf"):
        raise OptionError(f"fps {fps:g}: expected frames per second above 0")
    start = time.perf_counter()
    files = find_mesh_files(pattern)
    to_meshes = is_mesh_name(output)
    written = _outputs(output, options, frame_numbers(files), to_meshes)
    inputs = [InputFile(file, "a mesh file that is read") for file in files]
    check_outputs([*written, *other_outputs], inputs)
    folder = Path(output).absolute().parent
    try:
        if to_meshes:
            folder.mkdir(parents=True, exist_ok=True)
        work = temporary_path(folder, ".meshes")
        work.mkdir()
    except OSError as error:
        raise MeshFileError(f"{folder}: cannot be written ({error.strerror})") from error
    try:
        name = Path(pattern if isinstance(pattern, (str, os.PathLike)) else files[0]).stem
        source = work / f"{name.translate(PATTERN_LETTERS) or 'meshes'}.usdc"
        sequence = write_mesh_stage(files, source, fps, _part(progress, 0.0, READ_SHARE))
        target = work / "simplified.usdc" if to_meshes else Path(output)
        flat = not to_meshes and not (options.lods and not options.lod_files)
        rest = (_part(progress, READ_SHARE, 1.0 - READ_SHARE), announce)
        report = simplify_stage(source, target, replace(options, flatten=flat), *rest)
        if before_end is not None and report.output is not None:
            before_end(report)
        if to_meshes and report.output is not None:
            report.outputs = numbered_files(output, mesh_numbers(target))
            # With a range of frames they may be others than those of the input.
            check_outputs([*(OutputFile("output", file) for file in report.outputs), *other_outputs], inputs)
            export_meshes(target, report.outputs)
            report.output = report.outputs[0]
    finally:
        remove_path(work)
    report.input = os.fspath(pattern) if isinstance(pattern, (str, os.PathLike)) else files[0]
    report.problems = sequence.notes + report.problems
    if report.run is not None:
        report.run["seconds"] = time.perf_counter() - start
    return report


def _outputs(
    output: str | os.PathLike[str], options: SimplifyOptions, numbers: Sequence[int], to_meshes: bool
) -> list[OutputFile]:
    """The files that are going to be written.

    Raises:
        OptionError: they cannot be.
    """
    if to_meshes:
        check_mesh_output(output)
        if options.lods:
            raise OptionError("`lods`: levels of mesh files need a USD file as output, with `lod_files`, or a package")
        if options.bake_normals is not None:
            raise OptionError("`bake_normals`: a map needs a USD file as output, whose material names it")
        return [OutputFile("output", file) for file in numbered_files(output, numbers)]
    check_output_path(output, [], packages=True)
    if options.lods and not options.lod_files and not is_package(output):
        raise OptionError(
            "`lods`: levels are layers over the input, and mesh files are none; give `lod_files`, or a package (.usdz)"
        )
    return [OutputFile("output", file) for file in output_files(output, options)]


def _part(progress: Progress | None, start: float, share: float) -> Progress | None:
    if progress is None:
        return None
    return lambda fraction, text: progress(start + share * fraction, text)
