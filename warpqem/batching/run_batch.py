"""Run a batch."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Generator, Iterable
from contextlib import ExitStack
from pathlib import Path

from warpqem.arguments.number_input import check_function, flag, shown
from warpqem.arguments.progress import CancelToken, listener
from warpqem.batching.engine import Engine, Finished, Update
from warpqem.batching.job_result import BatchResult
from warpqem.batching.jobs import BatchJob, read_jobs
from warpqem.batching.journal import Journal
from warpqem.batching.local_engine import LocalEngine
from warpqem.batching.output_check import check_batch_outputs
from warpqem.errors import CancelledError, OptionError
from warpqem.files.outputs import OutputFile, named_outputs
from warpqem.files.temporary import note_folder, remove_leftovers

__all__ = ["batch"]

_log = logging.getLogger(__name__)


def batch(
    jobs: Iterable[BatchJob],
    engine: Engine | str = "local",
    *,
    journal: str | os.PathLike[str] | None = None,
    resume: bool = False,
    on_update: Callable[[Update], None] | None = None,
    other_outputs: Iterable[OutputFile] = (),
    cancel: CancelToken | None = None,
) -> Generator[BatchResult, None, None]:
    """Simplify many assets. One that fails, whatever way it does, costs the others nothing.

    Outputs appear under their names when they are whole. Work starts when the first result is asked for, and stops when
    the iterator is closed. A script that calls this needs `if __name__ == "__main__":`, because its workers import it.

    Args:
        jobs: What to do; see `warpqem.batching.jobs.find_files` and `warpqem.batching.manifest.read_manifest`.
        engine: Where: "local" for `warpqem.batching.local_engine.LocalEngine`, "ray" for
            `warpqem.batching.ray_engine.RayEngine`, both as they are by default, or an engine.
        journal: File that keeps what is done; None to keep nothing.
        resume: Leave out jobs that the journal knows as done and whose input, files, options and output have not
            changed since.
        on_update: Called with every update of the engine.
        other_outputs: What else the caller is going to write; see `warpqem.usd.simplify_stage`.
        cancel: Ends the batch from another thread, such as a `threading.Event`, at the next update of the engine.

    Yields:
        A result for each job, as they are done.

    Raises:
        OptionError: two outputs are the same file, an output is a file that a job reads, or there is no journal to
            resume from.
        BatchError: the journal is in use or cannot be written, or no worker can be started.
        UsdLibraryError: USD is missing, broken or too old on this machine, for the local engine.
        CancelledError: `cancel` was set. Outputs that are done stay, and a journal knows them.
    """
    jobs = read_jobs(jobs)
    if journal is not None and not isinstance(journal, (str, os.PathLike)):
        raise OptionError(f"journal must be a path or None, got {shown(journal)}")
    resume = flag(resume, "resume")
    check_function(on_update, "on_update")
    if resume and journal is None:
        raise OptionError("resume needs a journal")
    outputs = [*other_outputs, *named_outputs({"journal": journal})]
    unread = check_batch_outputs(jobs, outputs)
    listen = _updates_listener(on_update, cancel)
    return _results(jobs, unread, _engine(engine), journal, resume, listen)


def _updates_listener(
    on_update: Callable[[Update], None] | None, cancel: CancelToken | None
) -> Callable[[Update], None]:
    """What every update is given to: the caller's function, after a look at the token."""
    listener(None, cancel)

    def listen(update: Update) -> None:
        if cancel is not None and cancel.is_set():
            raise CancelledError("the batch was cancelled")
        if on_update is not None:
            on_update(update)

    return listen


def _engine(engine: Engine | str) -> Engine:
    if engine == "local":
        return LocalEngine()
    if engine == "ray":
        from warpqem.batching.ray_engine import RayEngine

        return RayEngine()
    if isinstance(engine, str):
        raise OptionError(f"engine {engine!r}: there are local and ray")
    if isinstance(engine, type) or not callable(getattr(engine, "run", None)):
        raise OptionError(f"engine must be local, ray or an object with a method run, got {shown(engine)}")
    return engine


def _results(
    jobs: list[BatchJob],
    unread: dict[str, BatchResult],
    engine: Engine,
    journal: str | os.PathLike[str] | None,
    resume: bool,
    on_update: Callable[[Update], None],
) -> Generator[BatchResult, None, None]:
    with ExitStack() as stack:
        notes = None if journal is None else stack.enter_context(Journal(journal))
        for folder in sorted({Path(job.output).parent for job in jobs}):
            for path in remove_leftovers(folder):
                _log.info("%s: removed, left by a process that was killed", path)
            note_folder(folder)
        todo = []
        for job in jobs:
            result = unread.get(job.output)
            if resume and notes is not None and notes.is_done(job):
                result = notes.skipped(job)
            if result is None:
                todo.append(job)
            else:
                on_update(Finished(job, result))
                yield result
        updates = engine.run(todo)
        stack.callback(updates.close)  # type: ignore[attr-defined]  # engines are generators
        for update in updates:
            # What is done is kept, whatever the caller makes of it.
            if isinstance(update, Finished) and notes is not None:
                notes.add(update.result)
            on_update(update)
            if isinstance(update, Finished):
                yield update.result
