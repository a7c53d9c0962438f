"""Options that do something to the worker that gets them, before it does the job."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from warpqem.usd import SimplifyOptions


@dataclass(frozen=True)
class TrapOptions(SimplifyOptions):
    """Springs when a worker unpickles it.

    Attributes:
        trap: Name of a function below.
        marker: File that a trap makes which springs once.
    """

    trap: str = ""
    marker: str = ""

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        TRAPS[self.trap](self.marker)


def hang(marker: str) -> None:
    time.sleep(600)


def crash(marker: str) -> None:
    os.write(2, b"a library gave up\n")
    os.abort()


def killed_once(marker: str) -> None:
    if not Path(marker).exists():
        Path(marker).touch()
        os.kill(os.getpid(), signal.SIGKILL)


def take_memory(marker: str) -> None:
    import warpqem.batching.perform_job as module

    whole = module.simplify_stage

    def greedy(*arguments: Any, **options: Any) -> Any:
        module.simplify_stage = whole
        return [bytearray(2**26) for _ in range(64)]

    module.simplify_stage = greedy


def full_disk(marker: str) -> None:
    import warpqem.usd.write.layer_files as module

    whole = module.os.replace

    def full(*_: Any) -> None:
        module.os.replace = whole
        raise OSError(28, "No space left on device")

    module.os.replace = full


def stop_while_writing(stop: Callable[[], None]) -> None:
    """Do something when the next output lies under its temporary name."""
    import warpqem.usd.write.layer_files as module

    module.make_readable = lambda path: stop()


def kill_itself() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def killed_while_writing(marker: str) -> None:
    stop_while_writing(kill_itself)


def killed_while_writing_once(marker: str) -> None:
    if not Path(marker).exists():
        Path(marker).touch()
        stop_while_writing(kill_itself)


def hang_while_writing(marker: str) -> None:
    def stop() -> None:
        Path(marker).touch()
        time.sleep(600)

    stop_while_writing(stop)


TRAPS = {
    "hang": hang,
    "crash": crash,
    "killed once": killed_once,
    "killed while writing": killed_while_writing,
    "killed while writing once": killed_while_writing_once,
    "hang while writing": hang_while_writing,
    "memory": take_memory,
    "full disk": full_disk,
}
