"""Jobs as Ray tasks on a cluster.

A task gets and gives paths and reports, never meshes: inputs and outputs lie on a file system that all nodes share.
"""

from __future__ import annotations

import logging
import os
import signal
import threading
import time
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from warpqem.batching.engine import Finished, Started, Update, lost, timed_out
from warpqem.batching.job_result import FAILED, BatchResult
from warpqem.batching.jobs import BatchJob
from warpqem.errors import BatchError, OptionError, UsdLibraryError
from warpqem.files.temporary import MARK_LENGTH, mark_temporary, remove_marked
from warpqem.runtime.memory import parse_bytes
from warpqem.usd.checks.library import need_usd

__all__ = ["RayEngine"]

# Seconds that a task may take to find a process, and that to start, before its time limit counts.
START_SECONDS = 60.0
# How long to wait for a result before limits and the size of the cluster are looked at again.
WAIT_SECONDS = 1.0
# Seconds for processes of tasks that are stopped to be gone.
END_SECONDS = 3.0

_log = logging.getLogger(__name__)


@dataclass(eq=False)
class _Task:
    """A job and its attempts so far. Its mark is that of the temporary files, whichever node they are written on."""

    job: BatchJob
    attempts: int = 0
    started: float = 0.0
    mark: str = field(default_factory=lambda: uuid.uuid4().hex[:MARK_LENGTH])

    def begin(self) -> None:
        self.attempts, self.started = self.attempts + 1, time.monotonic()

    def clear(self) -> None:
        """Remove what a process that has ended was writing."""
        remove_marked(Path(self.job.output).parent, self.mark)


class RayEngine:
    """One task for each job, no more at a time than the cluster has room for."""

    def __init__(
        self,
        address: str | None = None,
        cpus: float = 1.0,
        gpus: float | None = None,
        timeout: float | None = None,
        memory: int | str | None = None,
        retries: int = 3,
    ) -> None:
        """Nothing is started yet.

        Args:
            address: The cluster, "auto" for the one this machine is a part of; None for the one this process is
                connected to, or else a new one on this machine.
            cpus: CPU cores of a task.
            gpus: GPUs of a task, also a part of one; None for one where the cluster has any.
            timeout: Seconds that a job may take; None for any number.
            memory: What a job may take whose options do not say; the cluster reserves it. None for what is free.
            retries: How often a job is begun again whose process or node was lost.

        Raises:
            OptionError: a value is out of range, or Ray is not installed.
        """
        if not cpus > 0:
            raise OptionError(f"cpus {cpus:g}: expected a number above 0")
        if gpus is not None and not gpus >= 0:
            raise OptionError(f"gpus {gpus:g}: expected 0 or more")
        if timeout is not None and not timeout > 0:
            raise OptionError(f"timeout {timeout:g}: expected seconds above 0")
        if retries < 0:
            raise OptionError(f"retries {retries}: expected 0 or more")
        try:
            import ray
        except ImportError as error:
            raise OptionError("engine ray: Ray is not installed; pip install 'warpqem[ray]'") from error
        self._ray: Any = ray
        self.address, self.cpus, self.gpus = address, cpus, gpus
        self.timeout, self.retries = timeout, retries
        self.memory = None if memory is None else parse_bytes(memory)

    def run(self, jobs: Sequence[BatchJob]) -> Iterator[Update]:
        """See `warpqem.batching.engine.Engine.run`."""
        if not jobs:
            return
        connected_here = self._connect()
        pending: dict[Any, _Task] = {}
        try:
            perform = self._remote()
            waiting = [_Task(job) for job in reversed(jobs)]
            while waiting or pending:
                while waiting and len(pending) < self._slots():
                    task = waiting.pop()
                    task.begin()
                    pending[perform.remote(task.job, self._needs, task.mark)] = task
                    yield Started(task.job)
                ready, _ = self._ray.wait(list(pending), num_returns=1, timeout=WAIT_SECONDS)
                for reference in ready:
                    task = pending.pop(reference)
                    result = self._fetch(reference, task)
                    if result is None:
                        waiting.append(task)
                    else:
                        yield Finished(task.job, result)
                yield from self._stop_late(pending)
        finally:
            self._cancel(pending)
            if connected_here:
                self._ray.shutdown()

    def _connect(self) -> bool:
        if self._ray.is_initialized():
            return False
        try:
            with _handlers_kept():
                self._ray.init(address=self.address, log_to_driver=False, logging_level=logging.WARNING)
        except (ConnectionError, RuntimeError, ValueError) as error:
            raise BatchError(f"Ray at {self.address}: no connection ({' '.join(str(error).split())})") from error
        except BaseException:
            # Half a cluster may have been started.
            self._ray.shutdown()
            raise
        return True

    def _remote(self) -> Any:
        gpus = self.gpus
        if gpus is None:
            gpus = 1.0 if self._ray.cluster_resources().get("GPU") else 0.0
        self._needs = {"CPU": self.cpus, "GPU": gpus, "memory": self.memory or 0}
        # What has lost its process is begun again here: Ray counts no attempts, and does not clear what they left.
        return self._ray.remote(
            num_cpus=self.cpus,
            num_gpus=gpus,
            memory=self.memory,
            max_retries=0,
        )(_perform)

    def _slots(self) -> int:
        """How many tasks the cluster has room for now; it may grow."""
        return max(1, _room(self._ray.cluster_resources(), self._needs))

    def _fetch(self, reference: Any, task: _Task) -> BatchResult | None:
        """The result of a task that has ended; None where it has lost its process and is to be begun again."""
        try:
            result: BatchResult = self._ray.get(reference)
        except self._ray.exceptions.RayError as error:
            _log.warning("%s: %s", task.job.input, error)
            task.clear()
            if task.attempts <= self.retries and not isinstance(error, self._final_errors()):
                return None
            first = next((line.strip() for line in str(error).splitlines() if line.strip()), "")
            how = f"was lost ({type(error).__name__}: {first})"
            return lost(task.job, how, task.attempts, time.monotonic() - task.started)
        result.attempts = task.attempts
        return result

    def _final_errors(self) -> tuple[type[Exception], ...]:
        """Errors of tasks that would end in the same way again; not every version of Ray has all of them."""
        names = ("RayTaskError", "TaskCancelledError", "RuntimeEnvSetupError", "TaskUnschedulableError")
        known = (getattr(self._ray.exceptions, name, None) for name in names)
        return tuple(error for error in known if error is not None)

    def _stop_late(self, pending: dict[Any, _Task]) -> Iterator[Update]:
        for reference, task in list(pending.items()):
            if self.timeout is not None and time.monotonic() - task.started > self.timeout + START_SECONDS:
                del pending[reference]
                self._cancel({reference: task})
                yield Finished(task.job, timed_out(task.job, self.timeout, task.attempts))

    def _cancel(self, tasks: dict[Any, _Task]) -> None:
        """End tasks and their processes, and remove what they were writing."""
        for reference in tasks:
            with suppress(self._ray.exceptions.RayError, ValueError):
                self._ray.cancel(reference, force=True)
        if tasks:
            # Each is ready when its process is gone.
            self._ray.wait(list(tasks), num_returns=len(tasks), timeout=END_SECONDS)
        for task in tasks.values():
            task.clear()


@contextmanager
def _handlers_kept() -> Iterator[None]:
    """Ray takes SIGTERM over from the program that it is connected to; that program's own handler stays instead."""
    handler = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread() and handler is not None:
            signal.signal(signal.SIGTERM, handler)


def _perform(job: BatchJob, needs: dict[str, float], mark: str) -> BatchResult:
    """The task of a job."""
    _begin(needs)
    try:
        need_usd()
    except UsdLibraryError as error:
        return BatchResult(job.input, job.output, FAILED, type(error).__name__, f"{job.input}: {error}")
    from warpqem.batching.perform_job import perform

    memory = int(needs["memory"]) or None
    with mark_temporary(mark):
        return perform(job, memory=memory)


def _begin(needs: dict[str, float]) -> None:
    """Set up the process. Threads are counted when the first long launch needs them, which is later than this."""
    os.environ["WARPQEM_THREADS"] = str(max(1, int(needs["CPU"])))
    import warp as wp

    from warpqem.runtime.load_timeout import report_loading

    report_loading(lambda file, begins: None)
    wp.config.log_level = wp.LOG_WARNING


def _room(has: dict[str, float], needs: dict[str, float]) -> int:
    """How many tasks there is room for."""
    return int(min(has.get(name, 0.0) // need for name, need in needs.items() if need))
