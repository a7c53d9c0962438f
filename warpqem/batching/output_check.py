"""Compare the outputs of a batch with all files that its inputs need, before anything is written.

Finding these files needs USD, which a damaged file can crash: it is done by processes that can be done without, as the
jobs themselves are. A job whose files cannot be found is not begun: others could write over them meanwhile.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from typing import Any

from warpqem.batching.engine import lost
from warpqem.batching.job_result import FAILED, BatchResult, named
from warpqem.batching.jobs import BatchJob, check_jobs
from warpqem.batching.local_engine import MAIN_HINT, OUTSIDE_SIGNALS, ending
from warpqem.batching.worker import end_with_parent, redirect_output
from warpqem.errors import BatchError, OptionError
from warpqem.files.outputs import OutputFile, OutputFiles
from warpqem.runtime.cpu_threads import thread_count

__all__ = ["check_batch_outputs"]

# Jobs that are worth a process more: it takes about as long to start as so many are looked at.
JOBS_PER_PROCESS = 16
# How often a job is looked at whose process was stopped from outside.
MAX_TRIES = 3
# How long a process may take to end whose connection is closed.
ENDING_SECONDS = 10.0

_log = logging.getLogger(__name__)


# What a process is asked to look at: the files of a job, and the folders that all they need must be in.
Question = tuple[list[str], tuple[str, ...]]


def check_batch_outputs(jobs: Sequence[BatchJob], other_outputs: Iterable[OutputFile] = ()) -> dict[str, BatchResult]:
    """Refuse a batch that would write over a file which one of its jobs needs.

    The files that jobs need are looked for where an output is there already; otherwise nothing can be written over.

    Args:
        jobs: The jobs.
        other_outputs: What else is going to be written, such as reports.

    Returns:
        By output the results of jobs whose files cannot be found: they have failed.

    Raises:
        OptionError: an output is an input, a layer, clip or texture of one, or the same file as another output.
        BatchError: no process can be started.
    """
    written = check_jobs(jobs, other_outputs)
    if not written.any_exists:
        return {}
    _log.info("finding the files that %d inputs need, as some of the outputs are there already", len(jobs))
    found = _find_problems(jobs, written.outputs)
    return {jobs[index].output: result for index, result in found.items()}


def _find_problems(jobs: Sequence[BatchJob], outputs: Sequence[OutputFile]) -> dict[int, BatchResult]:
    """Look at each job in one of some processes; returns by index what those end with that cannot be read."""
    failed: dict[int, BatchResult] = {}
    waiting = deque((index, 1) for index in range(len(jobs)))
    count = min(thread_count("cpu"), -(-len(jobs) // JOBS_PER_PROCESS))
    with _processes(count, outputs) as processes:
        while waiting or any(process.at is not None for process in processes):
            for process in processes:
                if process.at is None and waiting:
                    index, tries = waiting.popleft()
                    process.begin(index, tries, _question(jobs[index]))
            for process in _with_news(processes):
                index, tries = process.at or (0, 0)
                try:
                    problem = process.answer()
                except (EOFError, OSError):
                    how = process.end()
                    processes.remove(process)
                    if tries < MAX_TRIES and any(name in how for name in OUTSIDE_SIGNALS):
                        waiting.appendleft((index, tries + 1))
                    else:
                        failed[index] = lost(jobs[index], how, tries, 0.0)
                    if waiting:
                        processes.append(_Process(outputs))
                    continue
                if problem is not None:
                    job, (name, text) = jobs[index], problem
                    failed[index] = BatchResult(job.input, job.output, FAILED, error=name, message=text)
    return failed


class _Process:
    """A process that looks at one job after another."""

    def __init__(self, outputs: Sequence[OutputFile]) -> None:
        self._connection, there = multiprocessing.Pipe()
        self._process = multiprocessing.get_context("spawn").Process(target=_serve, args=(there, outputs), daemon=True)
        self._process.start()
        there.close()
        self._loaded = False
        # Index of the job that it looks at, and which try that is; None for no job.
        self.at: tuple[int, int] | None = None

    @property
    def handles(self) -> list[Any]:
        """What is ready when it has answered or ended."""
        return [self._connection, self._process.sentinel]

    def begin(self, index: int, tries: int, question: Question) -> None:
        """Let it look at a job.

        Raises:
            BatchError: the process could not be started.
        """
        if not self._loaded:
            try:
                self._loaded = bool(self._connection.recv())
            except (EOFError, OSError):
                raise BatchError(f"no process can be started: it {self.end()} ({MAIN_HINT})") from None
        self.at = index, tries
        with suppress(OSError):  # it has just died, which is seen next
            self._connection.send(question)

    def answer(self) -> tuple[str, str] | None:
        """Name and text of the error that a job ends with; None for none.

        Raises:
            OptionError: an output is a file that the job needs.
            EOFError, OSError: the process has ended.
        """
        if not self._connection.poll():
            raise EOFError
        refusal, problem = self._connection.recv()
        self.at = None
        if refusal is not None:
            raise OptionError(refusal)
        found: tuple[str, str] | None = problem
        return found

    def end(self) -> str:
        """Wait until it has ended; returns how it ended."""
        # One that has lost its connection is about to end by itself, and shows how.
        self._process.join(ENDING_SECONDS)
        self.kill()
        return ending(self._process.exitcode)

    def kill(self) -> None:
        """End it at once."""
        self._process.kill()
        self._process.join()
        self._connection.close()


@contextmanager
def _processes(count: int, outputs: Sequence[OutputFile]) -> Iterator[list[_Process]]:
    processes = [_Process(outputs) for _ in range(count)]
    try:
        yield processes
    finally:
        for process in processes:
            process.kill()


def _with_news(processes: Sequence[_Process]) -> list[_Process]:
    at_work = [process for process in processes if process.at is not None]
    ready = wait([handle for process in at_work for handle in process.handles])
    return [process for process in at_work if any(handle in ready for handle in process.handles)]


def _question(job: BatchJob) -> Question:
    poses = [] if job.options.poses is None else [os.fspath(job.options.poses)]
    return [job.input, *poses], job.options.asset_roots


def _serve(connection: Connection, outputs: Sequence[OutputFile]) -> None:
    """Look at the jobs that come through a connection until it ends."""
    # The process that started this one answers Ctrl-C.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    redirect_output(os.devnull)
    end_with_parent()
    # Files that never open end the process.
    from warpqem.runtime.load_timeout import report_loading
    from warpqem.usd.checks.input_files import stage_files
    from warpqem.usd.read.open_stage import open_stage

    report_loading(lambda file, begins: None)
    written = OutputFiles(outputs)
    connection.send(True)
    with suppress(EOFError, OSError):
        while True:
            paths, roots = connection.recv()
            refusal: str | None = None
            problem: tuple[str, str] | None = None
            try:
                for path in paths:
                    written.check(stage_files(open_stage(path, roots), written))
            except OptionError as error:
                refusal = str(error)
            except Exception as error:
                # As the job itself would end.
                problem = type(error).__name__, named(paths[0], error)
            connection.send((refusal, problem))
