"""What an output was made from: the bytes of the input and of all files it needs, the options, the version.

USD finds the files; looking whether they have changed needs none, so that files of any kind can be looked at in the
process that runs a batch.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any

import warpqem
from warpqem.batching.jobs import BatchJob
from warpqem.files.file_kinds import kind_of
from warpqem.usd.commands.output_names import output_files

__all__ = ["file_hash", "files_hash", "is_current", "take_fingerprint"]

READ_BYTES = 2**20
# What an output does not depend on: how much is worked on at a time has no part in the bits.
NOT_IN_OUTPUT = ("memory",)


def file_hash(path: str | os.PathLike[str]) -> str | None:
    """SHA-256 of a file's bytes; None if it cannot be read."""
    digest = hashlib.sha256()
    if not os.path.isfile(path) or kind_of(path) is not None:
        return None  # nor does what never ends, such as a device, have a hash
    try:
        with open(path, "rb") as file:
            while block := file.read(READ_BYTES):
                digest.update(block)
    except OSError:
        return None
    return digest.hexdigest()


def files_hash(paths: Sequence[str | os.PathLike[str]]) -> str | None:
    """Hash of one file, or of several in their order; None if one of them cannot be read."""
    if len(paths) == 1:
        return file_hash(paths[0])
    hashes = [file_hash(path) for path in paths]
    return None if None in hashes else hashlib.sha256("\n".join(map(str, hashes)).encode()).hexdigest()


def take_fingerprint(
    job: BatchJob, begun: float = math.inf, files: Iterable[str] | None = None
) -> dict[str, Any] | None:
    """The fingerprint of a job, before it is done.

    Args:
        job: The job.
        begun: When USD began to read its files, in seconds since 1970.
        files: All files that it needs; see `warpqem.usd.checks.input_check.OpenedLayers`. None to look for them.

    Returns:
        The fingerprint; None where a file has changed since, so that it is not known which bytes were read.

    Raises:
        StageError: the input, or the file with poses, cannot be read.
    """
    if files is None:
        from warpqem.usd.checks.input_check import open_layers

        opened = [open_layers(path) for path in (job.input, job.options.poses) if path is not None]
        files = [file for each in opened for file in each.files]
    read = list(files)
    if job.options.face_points is not None:
        read.append(os.path.abspath(job.options.face_points))
    hashes: dict[str, str | None] = {}
    for file in sorted(set(read)):
        hashes[file] = file_hash(file)
        if hashes[file] is not None and os.path.getmtime(file) >= begun:
            return None
    return {"recipe": recipe(job), "files": hashes}


def recipe(job: BatchJob) -> str:
    """Hash of all that decides an output beside the bytes of files."""
    options = {name: value for name, value in asdict(job.options).items() if name not in NOT_IN_OUTPUT}
    text = json.dumps(
        [warpqem.__version__, os.path.abspath(job.input), os.path.abspath(job.output), options],
        sort_keys=True,
        default=os.fspath,
    )
    return hashlib.sha256(text.encode()).hexdigest()


def is_current(job: BatchJob, record: dict[str, Any]) -> bool:
    """True if a job that was recorded as done needs not be done again.

    Args:
        job: The job.
        record: What `warpqem.batching.journal.Journal` keeps of it: the fingerprint and the hash of the output.
    """
    try:
        fingerprint = record["fingerprint"]
        if fingerprint["recipe"] != recipe(job):
            return False
        if files_hash(output_files(job.output, job.options)) != record["output_hash"]:
            return False
        return all(file_hash(path) == known for path, known in fingerprint["files"].items())
    except (KeyError, TypeError, AttributeError):
        # Written by another version, or by hand.
        return False
