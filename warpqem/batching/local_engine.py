"""Jobs in processes on this machine: some that share each GPU, or the CPU's cores."""

from __future__ import annotations

import atexit
import logging
import multiprocessing
import os
import re
import signal
import tempfile
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

import warp as wp

from warpqem.batching.engine import Finished, Progressed, Started, Update, lost, timed_out
from warpqem.batching.job_result import BatchResult
from warpqem.batching.jobs import BatchJob
from warpqem.batching.worker import WorkerSetup, run_worker
from warpqem.errors import BatchError, OptionError
from warpqem.files.temporary import note_folder, remove_leftovers, remove_path, temporary_path
from warpqem.runtime.cpu_threads import thread_count
from warpqem.runtime.device import resolve_device
from warpqem.runtime.load_timeout import TIME_IS_UP
from warpqem.runtime.memory import DEFAULT_SHARE, available_memory, parse_bytes
from warpqem.runtime.process_limits import limit_behind_signal
from warpqem.runtime.processes import note_process
from warpqem.usd.checks.library import need_usd

__all__ = ["MAIN_HINT", "OUTSIDE_SIGNALS", "LocalEngine", "ending"]

# Processes that share a GPU, so that it has work while others read, measure and write: of a small asset with quality
# "best" kernels are a third of the time even on a CPU. Threads of one process would not do: Warp has one current stream
# for each device, and what a thread does while another one captures a graph becomes part of it. No GPU has measured it.
WORKERS_PER_GPU = 4
# Workers that die before they are ready, one after another, until a batch gives up.
MAX_FAILED_STARTS = 3
# Workers import the script that starts them, and must not start a batch again.
MAIN_HINT = 'a script that runs a batch needs if __name__ == "__main__":'
# A worker that ends by one of these was stopped from outside, also for want of memory: its job may be tried again. One
# that crashes by itself would do so again.
OUTSIDE_SIGNALS = ("SIGKILL", "SIGTERM", "SIGHUP", "SIGQUIT")
# How much of what a worker printed last is searched for the reason why it ended, and how much the message quotes.
TAIL_BYTES, TAIL_TEXT = 4096, 200

_log = logging.getLogger(__name__)


@dataclass(eq=False)
class _Task:
    job: BatchJob
    attempts: int = 0


@dataclass(eq=False)
class _Worker:
    process: Any
    connection: Connection
    output: str
    device: str
    loaded: bool = False
    warming: bool = False
    ready: bool = False
    task: _Task | None = None
    started: float = 0.0


class LocalEngine:
    """Workers that do many jobs each. One that is killed, hangs or crashes costs its job and is replaced."""

    def __init__(
        self,
        workers: int | None = None,
        timeout: float | None = None,
        memory: int | str | None = None,
        retries: int = 1,
        device: str | None = None,
    ) -> None:
        """Nothing is started yet.

        Args:
            workers: Processes; None for as many as there are cores, and no more than ``WORKERS_PER_GPU`` for each GPU
                where there are any.
            timeout: Seconds that a job may take; None for any number.
            memory: What a worker may take for a job whose options do not say; None for its part of what is free.
            retries: How often a job is begun again whose worker was stopped from outside.
            device: Warp device of jobs whose options name none.

        Raises:
            OptionError: a value is out of range.
            DeviceError: there is no such device.
            UsdLibraryError: USD is missing, broken or too old.
        """
        need_usd()
        if workers is not None and workers < 1:
            raise OptionError(f"jobs {workers}: expected at least 1 process")
        if timeout is not None and not timeout > 0:
            raise OptionError(f"timeout {timeout:g}: expected seconds above 0")
        if retries < 0:
            raise OptionError(f"retries {retries}: expected 0 or more")
        self.timeout, self.retries = timeout, retries
        self.device = None if device is None else resolve_device(device)
        self._asked = workers
        self._memory = None if memory is None else parse_bytes(memory)

    def run(self, jobs: Sequence[BatchJob]) -> Iterator[Update]:
        """See `warpqem.batching.engine.Engine.run`."""
        if not jobs:
            return
        pool = _Pool(self, jobs)
        try:
            yield from pool.run()
        finally:
            pool.close()

    def worker_count(self, job_count: int, devices: Sequence[str]) -> int:
        """How many processes there are for so many jobs on some devices."""
        count = thread_count("cpu")
        if list(devices) != ["cpu"]:
            count = max(len(devices), min(count, WORKERS_PER_GPU * len(devices)))
        return min(self._asked or count, job_count)

    def setup(self, workers: int, device: str, output: str, devices: int = 1) -> WorkerSetup:
        """What one of so many workers on so many devices is to be like."""
        memory = self._memory
        if memory is None:
            free = available_memory("cpu")
            memory = None if free is None else int(DEFAULT_SHARE * free) // workers
        return WorkerSetup(max(1, thread_count("cpu") // workers), device, memory, output, -(-workers // devices))


class _Pool:
    """The workers of one run."""

    def __init__(self, engine: LocalEngine, jobs: Sequence[BatchJob]) -> None:
        self.engine = engine
        self.workers: list[_Worker] = []
        self._waiting = deque(_Task(job) for job in jobs)
        self._left = len(jobs)
        self._devices = [engine.device] if engine.device else _all_devices()
        self._size = engine.worker_count(len(jobs), self._devices)
        self._failed_starts = 0
        # Kernels are compiled by one worker, and found by the others.
        self._warm = False
        self._folder = temporary_path(Path(tempfile.gettempdir()), ".batch")
        self._folder.mkdir(mode=0o700)
        self._started, self._owner = 0, os.getpid()
        # Where an error keeps the iterator of a batch from being closed, the end of the process does it, which waits
        # where another thread is about it.
        self._lock, self._closed = threading.RLock(), False
        atexit.register(self.close)

    def run(self) -> Iterator[Update]:
        for number in range(self._size):
            self._start(self._devices[number % len(self._devices)])
        while self._left:
            yield from self._assign()
            for worker in self._wait():
                yield from self._read(worker)
            yield from self._stop_late()

    def close(self) -> None:
        """End all workers at once, and remove what they were writing."""
        if os.getpid() != self._owner:  # a process that was forked from this one ends
            return
        with self._lock:
            self._closed = True
            while self.workers:
                worker = self.workers[-1]
                self._kill(worker)
                if worker in self.workers:
                    self.workers.remove(worker)
            remove_path(self._folder)
        atexit.unregister(self.close)

    def _start(self, device: str) -> None:
        self._started += 1
        output = os.path.join(self._folder, f"{self._started}.txt")
        here, there = multiprocessing.Pipe()
        process = multiprocessing.get_context("spawn").Process(
            target=run_worker,
            args=(there, self.engine.setup(self._size, device, output, len(self._devices))),
            daemon=True,
        )
        with self._lock:
            if self._closed:  # by the end of the process, while another thread reads what workers say
                return
            # Before it starts, so that one whose start is interrupted is not forgotten.
            self.workers.append(_Worker(process, here, output, device))
            _start_undisturbed(process)
        if process.pid is not None:
            note_process(process.pid)
        there.close()
        _log.debug("worker %s started", process.pid)

    def _assign(self) -> Iterator[Update]:
        for worker in self.workers:
            if worker.ready and worker.task is None and self._waiting:
                task = self._waiting.popleft()
                task.attempts += 1
                worker.task, worker.started = task, time.monotonic()
                note_folder(Path(task.job.output).parent)
                with suppress(OSError):  # it has just died, which is seen next
                    worker.connection.send(task.job)
                _log.info("%s: begun by worker %s", task.job.input, worker.process.pid)
                yield Started(task.job)

    def _wait(self) -> list[_Worker]:
        """The workers that have something to say, or have ended."""
        handles = {worker.connection: worker for worker in self.workers}
        sentinels = {worker.process.sentinel: worker for worker in self.workers}
        found: list[Any] = wait([*handles, *sentinels], self._patience())
        ready = {id(worker): worker for worker in (handles.get(item) or sentinels[item] for item in found)}
        return list(ready.values())

    def _patience(self) -> float | None:
        if self.engine.timeout is None:
            return None
        starts = [worker.started for worker in self.workers if worker.task is not None]
        return max(0.0, min(starts) + self.engine.timeout - time.monotonic()) if starts else None

    def _read(self, worker: _Worker) -> Iterator[Update]:
        try:
            while worker in self.workers and worker.connection.poll():
                kind, value = worker.connection.recv()
                yield from getattr(self, f"_take_{kind}")(worker, value)
        except (EOFError, OSError):
            yield from self._bury(worker)

    def _take_loaded(self, worker: _Worker, value: None) -> Iterator[Update]:
        worker.loaded = True
        self._warm_up()
        yield from ()

    def _warm_up(self) -> None:
        """Let loaded workers load the kernels, one of them before the others."""
        for worker in self.workers:
            if worker.loaded and not worker.warming:
                if not self._warm and any(other.warming for other in self.workers):
                    return
                worker.warming = True
                with suppress(OSError):  # it has just died, which is seen next
                    worker.connection.send(None)

    def _take_ready(self, worker: _Worker, value: None) -> Iterator[Update]:
        worker.ready = self._warm = True
        self._failed_starts = 0
        self._warm_up()
        yield from ()

    def _take_progress(self, worker: _Worker, value: tuple[float, str]) -> Iterator[Update]:
        if worker.task is not None:
            yield Progressed(worker.task.job, *value)

    def _take_log(self, worker: _Worker, value: tuple[str, int, str, str]) -> Iterator[Update]:
        name, level, text, traceback = value
        logging.getLogger(name).log(level, "%s", text, extra={"traceback": traceback})
        yield from ()

    def _take_result(self, worker: _Worker, result: BatchResult) -> Iterator[Update]:
        task, worker.task = worker.task, None
        assert task is not None
        result.attempts = task.attempts
        self._left -= 1
        if result.error == "MemoryError" and self._waiting:
            # What it has taken it may not give back.
            yield from self._replace(worker)
        yield Finished(task.job, result)

    def _bury(self, worker: _Worker) -> Iterator[Update]:
        """A worker has ended by itself, or by somebody else."""
        worker.process.join()
        how = ending(worker.process.exitcode) + _last_words(worker.output)
        _log.warning("worker %s %s", worker.process.pid, how)
        if not worker.ready:
            self._failed_starts += 1
            if self._failed_starts >= MAX_FAILED_STARTS:
                raise BatchError(f"no worker can be started: the last one {how} ({MAIN_HINT})")
        task = worker.task
        yield from self._replace(worker)
        if task is None:
            return
        if task.attempts <= self.engine.retries and any(name in how for name in OUTSIDE_SIGNALS):
            self._waiting.appendleft(task)
            return
        self._left -= 1
        yield Finished(task.job, lost(task.job, how, task.attempts, time.monotonic() - worker.started))

    def _stop_late(self) -> Iterator[Update]:
        limit = self.engine.timeout
        for worker in list(self.workers) if limit is not None else ():
            task = worker.task
            if task is None or limit is None or time.monotonic() - worker.started < limit:
                continue
            # Its result may have come at the last moment.
            if worker.connection.poll():
                yield from self._read(worker)
            if worker.task is task:
                self._left -= 1
                yield from self._replace(worker)
                _log.warning("%s: stopped after %g s", task.job.input, limit)
                yield Finished(task.job, timed_out(task.job, limit, task.attempts))

    def _replace(self, worker: _Worker) -> Iterator[Update]:
        self._kill(worker)
        if worker in self.workers:
            self.workers.remove(worker)
            if self._left > 0:
                self._start(worker.device)
                self._warm_up()
        yield from ()

    def _kill(self, worker: _Worker) -> None:
        if worker.process.pid is not None:
            worker.process.kill()
            worker.process.join()
        worker.connection.close()
        if worker.task is not None:
            remove_leftovers(Path(worker.task.job.output).parent, worker.process.pid)


def _all_devices() -> list[str]:
    """The GPUs of this machine, or its CPU; resolving a device starts Warp without its messages."""
    return ["cpu"] if resolve_device() == "cpu" else [gpu.alias for gpu in wp.get_cuda_devices()]


def ending(code: int | None) -> str:
    """How a process ended, in words, by its exit code."""
    if code is None or code >= 0:
        return f"ended with code {code}"
    name = str(code)
    with suppress(ValueError):
        name = signal.Signals(-code).name
    late = ": USD does not come to the end of a file, which is damaged" if name == TIME_IS_UP else ""
    limit = limit_behind_signal(name)
    return f"was ended by {name}{late}" + (f", for which this is the likely reason: {limit}" if limit else "")


def _start_undisturbed(process: Any) -> None:
    """Start a process that does not get Ctrl-C before it can ignore it; see `run_worker`."""

    def start() -> None:
        if hasattr(signal, "pthread_sigmask"):
            # Its own start, the first time, would let signals in.
            resource_tracker.ensure_running()
            signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))
        process.start()

    # On a thread, where no KeyboardInterrupt cuts the start short; a process that is half started says so with a
    # traceback. The signal mask is that of the thread, and the process inherits it.
    with ThreadPoolExecutor(1, thread_name_prefix="warpqem-start") as pool:
        pool.submit(start).result()


def _last_words(path: str) -> str:
    """The last line of what a worker printed, such as the message of a library that gave up."""
    try:
        with open(path, "rb") as file:
            file.seek(max(0, os.path.getsize(path) - TAIL_BYTES))
            lines = [
                line.strip() for line in file.read().decode("utf-8", "replace").splitlines() if re.search(r"\w", line)
            ]
    except OSError:
        return ""
    return f" ({lines[-1][:TAIL_TEXT]})" if lines else ""
