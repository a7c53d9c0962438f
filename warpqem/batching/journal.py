"""What is known of the jobs that are done: a journal in the folder of the outputs, one line for each.

A line is added when its output is under its final name, so that a batch that is killed at any moment has lost no more
than the lines of jobs that are then done again. A line that was being written is not one, and is left out.
"""

from __future__ import annotations

import json
import logging
import os
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

from warpqem.batching.fingerprint import files_hash, is_current
from warpqem.batching.job_result import DONE, SKIPPED, BatchResult, report_of
from warpqem.batching.jobs import BatchJob
from warpqem.errors import BatchError
from warpqem.files.file_kinds import check_regular

__all__ = ["JOURNAL_NAME", "Journal"]

JOURNAL_NAME = ".warpqem-batch.jsonl"
# What the journal keeps of a result, for the totals of a batch that is resumed.
COUNTS = ("faces", "faces_after", "face_frames")

_log = logging.getLogger(__name__)


class Journal:
    """The journal of a folder, held by one batch at a time."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Open it, and make it where it is missing.

        Args:
            path: The file.

        Raises:
            BatchError: it cannot be written, or another batch has it.
        """
        self.path = Path(path)
        check_regular(path, BatchError)
        try:
            self._file = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
        except OSError as error:
            raise BatchError(f"{self.path}: cannot be written ({error.strerror})") from error
        try:
            self._lock()
            self._records = self._read()
        except BaseException:
            os.close(self._file)
            raise
        self._told = self._cut = False

    def __enter__(self) -> Journal:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self._file)

    def is_done(self, job: BatchJob) -> bool:
        """True if the output is there, made from what the input and its files are now with the same options."""
        record = self._records.get(self._key(job.output))
        return record is not None and is_current(job, record)

    def skipped(self, job: BatchJob) -> BatchResult:
        """The result of a job that is done: the counts are those of the time when it was; 0 from older journals."""
        counts = self._records[self._key(job.output)].get("counts")
        known = counts if isinstance(counts, dict) else {}
        result = BatchResult(job.input, job.output, SKIPPED)
        for name in COUNTS:
            count = known.get(name)
            if isinstance(count, int) and not isinstance(count, bool):
                setattr(result, name, count)
        return result

    def add(self, result: BatchResult) -> None:
        """Note a job that is done. A full disk costs the note, not the batch."""
        if result.status != DONE or result.fingerprint is None:
            return
        record = {
            "output": self._key(result.output),
            "output_hash": files_hash(report_of(result).get("outputs") or [result.output]),
            "fingerprint": result.fingerprint,
            "counts": {name: getattr(result, name) for name in COUNTS},
        }
        try:
            # A line that a full disk cut short is ended first.
            data = ("\n" * self._cut + json.dumps(record) + "\n").encode()
            self._cut = os.write(self._file, data) < len(data)
        except OSError as error:
            if not self._told:
                _log.error("%s: cannot be written (%s); what is done now is done again later", self.path, error)
            self._told = True

    def _key(self, output: str) -> str:
        return os.path.relpath(output, self.path.parent)

    def _lock(self) -> None:
        try:
            import fcntl
        except ImportError:  # Windows: a second batch in one folder is not noticed
            return
        try:
            # The lock ends with the process, however that ends.
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise BatchError(f"{self.path.parent}: another batch is writing to this folder") from error

    def _read(self) -> dict[str, dict[str, Any]]:
        records: dict[str, dict[str, Any]] = {}
        data = self.path.read_bytes()
        for line in data.split(b"\n"):
            with suppress(ValueError, KeyError, TypeError):
                record = json.loads(line)
                records[record["output"]] = record
        if data and not data.endswith(b"\n"):
            # The next line must not become a part of one that was cut short.
            with suppress(OSError):
                os.write(self._file, b"\n")
        return records
