"""What an engine is, and the updates that it sends while it works."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

from warpqem.batching.job_result import FAILED, BatchResult
from warpqem.batching.jobs import BatchJob

__all__ = ["TIMED_OUT", "WORKER_LOST", "Engine", "Finished", "Progressed", "Started", "Update", "lost", "timed_out"]

# Names of the errors in a result where the process could not say anything itself.
WORKER_LOST, TIMED_OUT = "WorkerLost", "TimedOut"


@dataclass(frozen=True)
class Started:
    """A worker begins a job."""

    job: BatchJob


@dataclass(frozen=True)
class Progressed:
    """How far a job is: the fraction done, and what is being done."""

    job: BatchJob
    fraction: float
    text: str


@dataclass(frozen=True)
class Finished:
    """A job has its result, after which no update of it follows."""

    job: BatchJob
    result: BatchResult


Update = Started | Progressed | Finished


class Engine(Protocol):
    """Where jobs are done."""

    def run(self, jobs: Sequence[BatchJob]) -> Iterator[Update]:
        """Do all jobs in any order, each with one `Finished`, whatever happens to the process that has it.

        Closing the iterator stops the work; outputs that are not finished are then not there.

        Raises:
            BatchError: no job can be done at all.
        """
        ...


def lost(job: BatchJob, how: str, attempts: int, seconds: float) -> BatchResult:
    """The result of a job whose process ended without one."""
    message = f"{job.input}: the process that had it {how}"
    return BatchResult(
        job.input, job.output, FAILED, error=WORKER_LOST, message=message, attempts=attempts, seconds=seconds
    )


def timed_out(job: BatchJob, limit: float, attempts: int) -> BatchResult:
    """The result of a job that took too long."""
    message = f"{job.input}: not done after {limit:g} s, and stopped"
    return BatchResult(
        job.input, job.output, FAILED, error=TIMED_OUT, message=message, attempts=attempts, seconds=limit
    )
