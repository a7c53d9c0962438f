"""Contenders take turns, A B C A B C ..., each in its own process that sleeps while the others run."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.simplified import Simplified, load_simplified
from benchmarks.work import Work, save_work

__all__ = ["Outcome", "run_in_turn"]

ROOT = Path(__file__).resolve().parent.parent
# Lines of a failed process that say what went wrong.
LAST_WORDS = 3


@dataclass
class Outcome:
    """What one contender did.

    Attributes:
        seconds: wall time of each turn.
        cpu_seconds: CPU time of each turn, all threads.
        peak_bytes: host memory taken beyond what the process held before, the most of all turns.
        result: its last result; None where it failed.
        failure: why it failed, None where it did not.
    """

    seconds: list[float] = field(default_factory=list)
    cpu_seconds: list[float] = field(default_factory=list)
    peak_bytes: int = 0
    result: Simplified | None = None
    failure: str | None = None


class _Worker:
    """The process of one contender."""

    def __init__(self, name: str, work: Path, folder: Path, device: str | None) -> None:
        self.outcome = Outcome()
        self._result = folder / f"{name}.npz"
        self._errors = (folder / f"{name}.log").open("w+")
        command = [sys.executable, "-m", "benchmarks.worker", str(work), str(self._result), name]
        self._process = subprocess.Popen(
            [*command, *([device] if device else [])],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            text=True,
            cwd=ROOT,
        )

    def _read(self) -> dict[str, float] | None:
        """The next answer; None, and the failure noted, where the process has died."""
        line = self._process.stdout.readline() if self._process.stdout else ""
        if line:
            answer: dict[str, float] = json.loads(line)
            return answer
        code = self._process.wait()
        self._errors.seek(0)
        words = [line.strip() for line in self._errors if line.strip()][-LAST_WORDS:]
        self.outcome.failure = f"exit code {code}: {' | '.join(words)}"
        return None

    def _ask(self, command: str) -> dict[str, float] | None:
        if self.outcome.failure is not None or self._process.stdin is None:
            return None
        try:
            self._process.stdin.write(f"{command}\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            pass  # what it died of stands in its log
        return self._read()

    def wait_until_ready(self) -> None:
        self._read()

    def take_turn(self) -> None:
        answer = self._ask("run")
        if answer is not None:
            self.outcome.seconds.append(answer["seconds"])
            self.outcome.cpu_seconds.append(answer["cpu_seconds"])
            self.outcome.peak_bytes = max(self.outcome.peak_bytes, int(answer["peak_bytes"]))

    def fetch(self) -> None:
        if self._ask("save") is not None:
            self.outcome.result = load_simplified(self._result)

    def close(self) -> None:
        if self._process.stdin is not None:
            self._process.stdin.close()
        self._process.wait()
        self._errors.close()


def run_in_turn(
    work: Work, names: Sequence[str], turns: int, device: str | None = None, say: Callable[[str], None] = print
) -> dict[str, Outcome]:
    """Let each contender do the work once a turn, one at a time.

    Args:
        work: what to do.
        names: keys of ``CONTENDERS``, in the order of the turns.
        turns: how often each runs; a run before them, on a small mesh, does not count.
        device: Warp device, for those that use one.
        say: called with what is going on.
    """
    with tempfile.TemporaryDirectory(prefix="warpqem-bench-") as temporary:
        folder = Path(temporary)
        path = folder / "work.npz"
        save_work(work, path)
        workers: dict[str, _Worker] = {}
        try:
            for name in names:
                workers[name] = _Worker(name, path, folder, device)
                # One after another also here: a start-up beside a warm-up run would slow both.
                workers[name].wait_until_ready()
            for turn in range(turns):
                say(f"{work.name}: turn {turn + 1} of {turns}")
                for worker in workers.values():
                    worker.take_turn()
            for worker in workers.values():
                worker.fetch()
        finally:
            for worker in workers.values():
                worker.close()
        return {name: worker.outcome for name, worker in workers.items()}
