"""What became of a job."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from warpqem.arguments.json_types import Json
from warpqem.errors import WarpqemError

__all__ = ["DONE", "FAILED", "PARTIAL", "SKIPPED", "BatchResult", "named", "report_of"]

DONE, PARTIAL, FAILED, SKIPPED = "done", "partial", "failed", "skipped"


@dataclass
class BatchResult:
    """The outcome for one asset.

    Attributes:
        input: USD file that was read; the manifest, for a line of it that names none.
        output: USD file that was to be written; empty for a line of a manifest that is wrong.
        status: "done"; "partial" where the file was written but a mesh on it failed; "failed" where nothing was
            written; "skipped" where the file is there already, from the same input and options.
        error: Name of the error, such as "StageError"; None without one.
        message: What went wrong, with prim, attribute and time.
        seconds: Wall-clock time.
        faces: Triangles before.
        faces_after: Triangles after.
        face_frames: Triangles before times frames.
        attempts: How often the job was begun.
        peak_memory: Most bytes that the process had meanwhile; None where the system does not say.
        process: Where the job ran, such as "host:1234".
        report: The report on the stage; see `warpqem.usd.write.stage_report.StageReport`.
        fingerprint: What the output was made from; see `warpqem.batching.fingerprint`.
    """

    input: str
    output: str
    status: str
    error: str | None = None
    message: str | None = None
    seconds: float = 0.0
    faces: int = 0
    faces_after: int = 0
    face_frames: int = 0
    attempts: int = 1
    peak_memory: int | None = None
    process: str | None = None
    report: dict[str, Json] | None = None
    fingerprint: dict[str, Json] | None = None

    @property
    def ok(self) -> bool:
        """True if the whole output is there."""
        return self.status in (DONE, SKIPPED)

    def to_dict(self) -> dict[str, Json]:
        """Plain dictionaries, lists, numbers and None, ready for JSON."""
        return asdict(self)


def report_of(result: BatchResult) -> dict[str, Any]:
    """The report of an asset, empty without one; what its entries are only `StageReport.to_dict` says."""
    return result.report or {}


def named(source: str, error: Exception) -> str:
    """What an error says in one line, with the file that it is about."""
    # What is not of warpqem may come on many lines.
    text = str(error) if isinstance(error, WarpqemError) else " ".join(str(error).split())
    text = text or type(error).__name__
    return text if source in text else f"{source}: {text}"
