"""What is to be done in a batch: which file, to which, with which options."""

from __future__ import annotations

import glob
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from warpqem.errors import OptionError
from warpqem.number_input import shown
from warpqem.outputs import InputFile, OutputFile, OutputFiles
from warpqem.usd.simplify_options import SimplifyOptions

__all__ = ["BatchJob", "FoundFile", "check_jobs", "find_files", "output_path", "read_jobs"]

INPUT_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
OUTPUT_SUFFIXES = (".usd", ".usda", ".usdc")
# A package is read, never written; a binary layer stands in for it.
SUFFIX_FOR_PACKAGES = ".usdc"


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
    """The USD files that inputs name.

    Args:
        inputs: Files, also missing ones, folders (all USD files below them, but not what is hidden) and patterns such
            as "shots/**/*.usd".
        leave_out: A folder that is not searched, such as that of the outputs.

    Raises:
        OptionError: an input names nothing.
    """
    found: dict[Path, FoundFile] = {}
    for text in map(os.fspath, inputs):
        files = _files_of(text, leave_out)
        if not files:
            raise OptionError(f"{text}: no such file, and no folder or pattern with a USD file in it")
        for file in files:
            found.setdefault(file.path, file)
    return list(found.values())


def _files_of(text: str, leave_out: Path | None) -> list[FoundFile]:
    path = Path(text).absolute()
    if path.is_file() or (path.suffix.lower() in INPUT_SUFFIXES and not path.exists() and not glob.has_magic(text)):
        # One that is missing is found missing when its turn comes: it must not cost the others.
        return [FoundFile(path, Path(path.name))]
    if path.is_dir():
        return [FoundFile(file, file.relative_to(path)) for file in _walk(path, leave_out)]
    base = _fixed_part(text)
    files = []
    for match in sorted(glob.glob(text, recursive=True)):
        below = Path(match).absolute()
        below_files = _walk(below, leave_out) if below.is_dir() else [below] if _is_usd(below, leave_out) else []
        files += [FoundFile(file, file.relative_to(base)) for file in below_files]
    return list({file.path: file for file in files}.values())


def _fixed_part(pattern: str) -> Path:
    """The folder that all matches of a pattern lie in, as far as it is written out."""
    parts = []
    for part in Path(pattern).parts[:-1]:
        if glob.has_magic(part):
            break
        parts.append(part)
    return Path(*parts).absolute() if parts else Path.cwd()


def _walk(folder: Path, leave_out: Path | None) -> list[Path]:
    files = []
    for where, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        files += [Path(where, name) for name in sorted(names)]
    return [file for file in files if _is_usd(file, leave_out)]


def _is_usd(file: Path, leave_out: Path | None) -> bool:
    if file.name.startswith(".") or file.suffix.lower() not in INPUT_SUFFIXES:
        return False
    return file.is_file() and not (leave_out is not None and file.resolve().is_relative_to(leave_out.resolve()))


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
    written = OutputFiles([*(OutputFile("output", job.output) for job in jobs), *other_outputs])
    written.check(InputFile(job.input, "an input") for job in jobs)
    written.check(InputFile(job.options.poses, "a file of poses") for job in jobs if job.options.poses is not None)
    return written
