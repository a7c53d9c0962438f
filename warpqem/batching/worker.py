"""The process that does jobs one after another for `warpqem.batching.local_engine`.

It ends with the process that started it, however that ends. Little is imported before it knows how many threads it may
use.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
import time
from dataclasses import dataclass
from multiprocessing import parent_process
from multiprocessing.connection import Connection, wait
from typing import Any

from warpqem.runtime.load_timeout import report_loading

__all__ = ["WorkerSetup", "end_with_parent", "redirect_output", "run_worker"]

# No more than so many messages a second about progress.
MESSAGES_PER_SECOND = 5.0
# Variables from which libraries read how many threads to use.
THREAD_VARIABLES = ("WARPQEM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class WorkerSetup:
    """What a worker is to be like.

    Attributes:
        threads: CPU threads it may use.
        device: Warp device for jobs that name none.
        memory: Bytes it may take for a job that does not say; None for no limit.
        output: File that takes what libraries print.
        sharing: Workers on the same device, this one too.
    """

    threads: int
    device: str
    memory: int | None
    output: str
    sharing: int = 1


def run_worker(connection: Connection, setup: WorkerSetup) -> None:
    """Do the jobs that come through a connection until it ends."""
    # The process that started this one answers Ctrl-C.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGINT,))
    redirect_output(setup.output)
    report_loading(lambda file, begins: print(f"opening {file}", flush=True) if begins else None)
    for name in THREAD_VARIABLES:
        os.environ[name] = str(setup.threads)
    # What USD splits over threads gives the same on one, and a worker has as many as it has.
    os.environ["PXR_WORK_THREAD_LIMIT"] = str(setup.threads)
    end_with_parent()
    sender = _Sender(connection)
    root = logging.getLogger("warpqem")
    root.setLevel(logging.DEBUG)
    root.propagate = False
    root.addHandler(_Forward(sender))
    try:
        _serve(connection, sender, setup)
    except (EOFError, OSError):
        return


def _serve(connection: Connection, sender: _Sender, setup: WorkerSetup) -> None:
    import warp as wp

    from warpqem.batching.perform_job import perform, warm_up
    from warpqem.runtime.device import share_memory
    from warpqem.runtime.memory import parse_bytes
    from warpqem.runtime.process_memory import limited_memory
    from warpqem.usd.checks.usd_errors import UsdMessages

    wp.config.log_level = wp.LOG_WARNING
    usd_messages = UsdMessages()
    sender.send("loaded", None)
    # Its turn to look for kernels that are not compiled yet.
    connection.recv()
    share_memory(setup.device, setup.sharing)
    warm_up(setup.device)
    sender.send("ready", None)
    while True:
        job = connection.recv()
        own = job.options.memory
        limit = setup.memory if own is None else parse_bytes(own)
        with limited_memory(limit):
            result = perform(job, sender.progress, setup.device, setup.memory, setup.sharing)
        for text in usd_messages.take():
            _log.info("%s: USD: %s", job.input, text)
        sender.send("result", result)


class _Sender:
    """Sends messages from any thread."""

    def __init__(self, connection: Connection) -> None:
        self._connection, self._lock, self._last = connection, threading.Lock(), 0.0

    def send(self, kind: str, value: Any) -> None:
        with self._lock:
            self._connection.send((kind, value))

    def progress(self, fraction: float, text: str) -> None:
        now = time.monotonic()
        if now - self._last > 1 / MESSAGES_PER_SECOND:
            self._last = now
            self.send("progress", (fraction, text))


class _Forward(logging.Handler):
    """Sends log records to the process that started this one: name, level, text and traceback, empty for none."""

    def __init__(self, sender: _Sender) -> None:
        super().__init__()
        self._sender = sender

    def emit(self, record: logging.LogRecord) -> None:
        traceback = "" if record.exc_info is None else logging.Formatter().formatException(record.exc_info)
        self._sender.send("log", (record.name, record.levelno, record.getMessage(), traceback))


def redirect_output(path: str) -> None:
    """Let what this process and its libraries print go to a file."""
    file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    os.dup2(file, 1)
    os.dup2(file, 2)
    os.close(file)


def end_with_parent() -> None:
    """Let this process end when the one that started it has, however that was."""
    threading.Thread(target=_wait_for_parent, daemon=True).start()


def _wait_for_parent() -> None:
    parent = parent_process()
    assert parent is not None
    wait([parent.sentinel])
    # At once: the parent, which the result was for, has ended.
    os._exit(1)
