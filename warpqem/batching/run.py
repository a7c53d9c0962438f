"""Run a batch."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path

from warpqem.batching.engine import Engine, Finished, Update
from warpqem.batching.jobs import BatchJob, check_jobs
from warpqem.batching.local import LocalEngine
from warpqem.batching.result import SKIPPED, BatchResult
from warpqem.batching.state import Journal
from warpqem.errors import OptionError
from warpqem.usd.temporary import remove_leftovers

__all__ = ["batch"]

_log = logging.getLogger(__name__)


def batch(
    jobs: Iterable[BatchJob],
    engine: Engine | str = "local",
    *,
    journal: str | os.PathLike[str] | None = None,
    resume: bool = False,
    on_update: Callable[[Update], None] | None = None,
) -> Iterator[BatchResult]:
    """Simplify many assets. One that fails, whatever way it does, costs the others nothing.

    Outputs appear under their names when they are whole. Work starts when the first result is asked for, and stops when
    the iterator is closed. A script that calls this needs `if __name__ == "__main__":`, because its workers import it.

    Args:
        jobs: What to do; see `warpqem.batching.jobs.find_files` and `warpqem.batching.manifest.read_manifest`.
        engine: Where: "local" for `warpqem.batching.local.LocalEngine`, "ray" for
            `warpqem.batching.ray_engine.RayEngine`, both as they are by default, or an engine.
        journal: File that keeps what is done; None to keep nothing.
        resume: Leave out jobs that the journal knows as done and whose input, files, options and output have not
            changed since.
        on_update: Called with everything the engine tells.

    Yields:
        A result for each job, as they are done.

    Raises:
        OptionError: two jobs have the same output, an output is an input, or there is no journal to resume from.
        BatchError: the journal is in use or cannot be written, or no worker can be started.
        UsdLibraryError: USD is missing, broken or too old on this machine, for the local engine.
    """
    jobs = list(jobs)
    check_jobs(jobs)
    if resume and journal is None:
        raise OptionError("resume needs a journal")
    return _results(jobs, _engine(engine), journal, resume, on_update or (lambda update: None))


def _engine(engine: Engine | str) -> Engine:
    if engine == "local":
        return LocalEngine()
    if engine == "ray":
        from warpqem.batching.ray_engine import RayEngine

        return RayEngine()
    if isinstance(engine, str):
        raise OptionError(f"engine {engine!r}: there are local and ray")
    return engine


def _results(
    jobs: list[BatchJob],
    engine: Engine,
    journal: str | os.PathLike[str] | None,
    resume: bool,
    on_update: Callable[[Update], None],
) -> Iterator[BatchResult]:
    with ExitStack() as stack:
        notes = None if journal is None else stack.enter_context(Journal(journal))
        for folder in sorted({Path(job.output).parent for job in jobs}):
            for path in remove_leftovers(folder):
                _log.info("%s: removed, left by a process that was killed", path)
        todo = []
        for job in jobs:
            if resume and notes is not None and notes.is_done(job):
                result = BatchResult(job.input, job.output, SKIPPED)
                on_update(Finished(job, result))
                yield result
            else:
                todo.append(job)
        updates = engine.run(todo)
        stack.callback(updates.close)  # type: ignore[attr-defined]
        for update in updates:
            if isinstance(update, Finished) and notes is not None:
                notes.add(update.result)
            on_update(update)
            if isinstance(update, Finished):
                yield update.result
