"""What is to be done in a batch: which file, to which, with which options."""

from __future__ import annotations

import glob
import logging
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from warpqem.arguments.number_input import shown
from warpqem.batching.input_search import files_below, fixed_part, is_usd_name, match_pattern, same_file_key
from warpqem.errors import OptionError
from warpqem.files.outputs import InputFile, OutputFile, OutputFiles
from warpqem.usd.commands.output_names import output_files
from warpqem.usd.commands.simplify_options import SimplifyOptions

__all__ = ["BatchJob", "FoundFile", "check_jobs", "find_files", "output_path", "read_jobs"]

OUTPUT_SUFFIXES = (".usd", ".usda", ".usdc")
# Over a package there is a layer, as over any input; a package of the new meshes is written where it is asked for.
SUFFIX_FOR_PACKAGES = ".usdc"

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class BatchJob:
    """One asset.

    Attributes:
        input: USD file to read.
        output: USD file to write; its folder is made where it is missing.
        options: How to simplify.
    """

    input: str
    output: str
    options: SimplifyOptions


@dataclass(frozen=True)
class FoundFile:
    """A file to read, and its place below the folder it was looked for in.

    Attributes:
        path: Absolute path.
        relative: Path from that folder, such as "hero/body.usda".
    """

    path: Path
    relative: Path


def find_files(inputs: Sequence[str | os.PathLike[str]], leave_out: Path | None = None) -> list[FoundFile]:
    """The USD files that inputs name, each once, whatever links lead to it.

    What has the name of a USD file and is none, such as a pipe or a link to nothing, is found as well: it is named when
    its turn comes, and costs the others nothing.

    Args:
        inputs: Files, also missing ones, folders (all USD files below them, but not what is hidden) and patterns such
            as "shots/**/*.usd".
        leave_out: A folder that is not searched, such as that of the outputs.

    Raises:
        OptionError: an input names nothing.
    """
    found: list[FoundFile] = []
    for text in (os.fspath(given) for given in inputs):
        # Path("") is the folder of the process.
        files = _files_of(text, leave_out) if text else []
        if not files:
            raise OptionError(
                f"{text or 'an empty name'}: no such file, and no folder or pattern with a USD file in it"
            )
        found += files
    return _each_once(found)


def _each_once(files: list[FoundFile]) -> list[FoundFile]:
    """Of several paths to one file the first that is no link stays."""
    kept: dict[tuple[object, ...], FoundFile] = {}
    for file in files:
        key = same_file_key(file.path)
        other = kept.setdefault(key, file)
        if other.path == file.path:
            continue
        if _is_link(other.path) and not _is_link(file.path):
            kept[key], file, other = file, other, file
        _log.info("%s: left out, the same file as %s", file.path, other.path)
    return list(kept.values())


def _is_link(path: Path) -> bool:
    return os.path.realpath(path) != os.fspath(path)


def _files_of(text: str, leave_out: Path | None) -> list[FoundFile]:
    path = Path(text).absolute()
    if not path.is_dir() and (os.path.lexists(path) or (is_usd_name(path.name) and not glob.has_magic(text))):
        # One that is missing is found missing when its turn comes: it must not cost the others.
        return [FoundFile(path, Path(path.name))]
    if path.is_dir():
        return [FoundFile(file, file.relative_to(path)) for file in files_below(path) if _is_wanted(file, leave_out)]
    base = fixed_part(text)
    files = []
    for match in match_pattern(text):
        below = files_below(match) if match.is_dir() else [match] if is_usd_name(match.name) else []
        files += [FoundFile(file, _place(file, base)) for file in below if _is_wanted(file, leave_out)]
    return list({file.path: file for file in files}.values())


def _place(file: Path, base: Path) -> Path:
    """The place of a file below a folder; one that a pattern finds outside of it has its name alone."""
    relative = Path(os.path.relpath(file, base))
    return Path(file.name) if ".." in relative.parts else relative


def _is_wanted(file: Path, leave_out: Path | None) -> bool:
    real = Path(os.path.realpath(file))
    return not file.is_dir() and not (leave_out is not None and real.is_relative_to(os.path.realpath(leave_out)))


def output_path(folder: Path, relative: Path, suffix: str | None = None) -> str:
    """Where the output for an input goes: the same place below the folder, with the same suffix or another one."""
    if suffix is None:
        suffix = relative.suffix if relative.suffix.lower() in OUTPUT_SUFFIXES else SUFFIX_FOR_PACKAGES
    return os.fspath((folder / relative.with_suffix(suffix)).absolute())


def read_jobs(jobs: Any) -> list[BatchJob]:
    """The jobs of a batch, which any iterable gives.

    Raises:
        OptionError: it is none, or one of them is no :class:`BatchJob` with paths and options.
    """
    if isinstance(jobs, (str, bytes)) or not isinstance(jobs, Iterable):
        raise OptionError(f"jobs must be a list of BatchJob, got {shown(jobs)}")
    found = list(jobs)
    for index, job in enumerate(found):
        if not isinstance(job, BatchJob):
            raise OptionError(f"jobs[{index}] must be a BatchJob, got {shown(job)}")
        for name in ("input", "output"):
            if not isinstance(getattr(job, name), (str, os.PathLike)):
                raise OptionError(f"jobs[{index}].{name} must be a path, got {shown(getattr(job, name))}")
        if not isinstance(job.options, SimplifyOptions):
            raise OptionError(f"jobs[{index}].options must be SimplifyOptions, got {shown(job.options)}")
        if not isinstance(job.options.metric, str):
            raise OptionError(
                f"jobs[{index}].options.metric must be a name, which every process knows, got "
                f"{shown(job.options.metric)}; a package offers its cost model as an entry point"
            )
    return found


def check_jobs(jobs: Iterable[BatchJob], other_outputs: Iterable[OutputFile] = ()) -> OutputFiles:
    """Refuse jobs that would write over an input, or over each other's outputs.

    Args:
        jobs: The jobs.
        other_outputs: What else is going to be written.

    Returns:
        All outputs, to be compared with what the inputs need; see `warpqem.batching.output_check`.

    Raises:
        OptionError: two outputs are the same file, or an output is an input.
    """
    jobs, outputs = list(jobs), dict[str, BatchJob]()
    for job in jobs:
        other = outputs.setdefault(os.path.realpath(job.output), job)
        if other is not job:
            raise OptionError(
                f"output {job.output}: both {other.input} and {job.input} would be written there; "
                "give the folder they are in, which is kept"
            )
    files = [OutputFile("output", path) for job in jobs for path in output_files(job.output, job.options)]
    written = OutputFiles([*files, *other_outputs])
    written.check(InputFile(job.input, "an input") for job in jobs)
    for job in jobs:
        named = {"a file of poses": job.options.poses, "a file of points": job.options.face_points}
        written.check(InputFile(path, what) for what, path in named.items() if path is not None)
    return written
