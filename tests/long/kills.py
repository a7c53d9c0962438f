"""Kill a batch, or one of its workers, at random moments by any signal; resume it; compare with an undisturbed run.

python -m tests.long.kills --points 200 --seconds 500
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.support.usd_stages import cloth_stage, skinned_stage

# Batches take about as long as this from the first asset to the last; moments are drawn from it.
WINDOW_SECONDS = 2.0
SIGNALS = (signal.SIGKILL, signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)


def make_inputs(folder: Path, count: int) -> None:
    for index in range(count):
        path = folder / f"{index % 3}" / f"asset{index}.{('usda', 'usdc', 'usd')[index % 3]}"
        path.parent.mkdir(parents=True, exist_ok=True)
        if index % 4 == 3:
            skinned_stage(path)
        else:
            cloth_stage(path, size=12 + 2 * index)


def start(folder: Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "warpqem", "batch", str(folder / "in"), "-o", str(folder / "out"), "--resume"]
    options = ["--ratio", "0.3", "--device", "cpu", "--jobs", "2", "--json", "-", "--retries", "9"]
    return subprocess.Popen(
        [*command, *options], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, start_new_session=True
    )


def outputs(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted((folder / "out").rglob("*"))
        if path.is_file() and not path.name.startswith(".")
    }


def children(process: int) -> list[int]:
    found = subprocess.run(["ps", "-o", "pid=", "--ppid", str(process)], capture_output=True, text=True).stdout
    return [int(word) for word in found.split()]


def kill_somewhere(process: subprocess.Popen[str], draw: random.Random) -> str:
    """Wait for some results and some more, then kill the batch, all of it, or one worker."""
    for _ in range(draw.randrange(3)):
        if not process.stdout.readline():
            return "ended"
    time.sleep(draw.random() * WINDOW_SECONDS * draw.random())
    if process.poll() is not None:
        return "ended"
    # The command line is a process that watches another one, which does the work with the help of its workers.
    kind = draw.choice(("watcher", "batch", "group", "worker"))
    number = draw.choice(SIGNALS)
    if kind == "group":
        os.killpg(process.pid, number)
    elif kind == "watcher":
        process.send_signal(number)
    else:
        found = children(process.pid)
        if kind == "worker":
            found = [worker for batch in found for worker in children(batch)]
        if not found:
            return "ended"
        if kind == "worker" and number == signal.SIGINT:
            number = signal.SIGKILL  # workers leave Ctrl-C to the batch
        with contextlib.suppress(ProcessLookupError):
            os.kill(draw.choice(found), number)
    return kind


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--points", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=500.0)
    parser.add_argument("--assets", type=int, default=16)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    draw = random.Random(given.seed)
    folder = Path(tempfile.mkdtemp(prefix="kills-"))
    begun = time.monotonic()
    make_inputs(folder / "in", given.assets)
    inputs = {path: path.read_bytes() for path in (folder / "in").rglob("*.usd*")}
    start(folder).communicate()
    expected = outputs(folder)
    assert len(expected) == given.assets, sorted(expected)
    counts: dict[str, int] = {"watcher": 0, "batch": 0, "group": 0, "worker": 0}
    whole = 0
    shutil.rmtree(folder / "out")
    while sum(counts.values()) < given.points and time.monotonic() - begun < given.seconds:
        process = start(folder)
        kind = kill_somewhere(process, draw)
        if kind in counts:
            counts[kind] += 1
        if kind in ("worker", "ended"):
            process.communicate()
            # A worker that was killed costs nothing in the end.
            assert process.returncode == 0, process.returncode
            assert outputs(folder) == expected, "lost, half or different"
            left = list((folder / "out").rglob(".warpqem.*"))
            assert not left, left
            whole += 1
            shutil.rmtree(folder / "out")
        else:
            process.communicate()
            seen = outputs(folder) if (folder / "out").exists() else {}
            assert seen.items() <= expected.items(), "half or different"
        assert {path: path.read_bytes() for path in inputs} == inputs, "an input was touched"
    start(folder).communicate()
    assert outputs(folder) == expected, "lost, half or different"
    shutil.rmtree(folder)
    print(
        f"{sum(counts.values())} kills {counts}, {whole} whole batches, {time.monotonic() - begun:.0f} s: all the same"
    )


if __name__ == "__main__":
    main()
