"""Send every signal to every command at random moments: exit codes, what is left behind, and what the next run removes.

python -m tests.long.signals --seconds 300 [--commands simplify,levels] [--keep-going]
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import importlib.util
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from tests.support.usd_stages import cloth_stage

ROOT = Path(__file__).resolve().parent.parent.parent
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGKILL)
# The command's process, the one that does the work, both and their workers as a terminal does, and one worker.
TARGETS = ("command", "work", "group", "worker")
# The environment variable by which processes of one run are known, wherever they end up.
MARK = "WARPQEM_TEST_MARK"
# Signals come up to so many times the seconds that a run takes undisturbed.
WINDOW = 1.1
# Seconds until a command has ended, and until the last of its processes is gone.
PATIENCE, GONE = 30.0, 10.0


@dataclass
class Command:
    """A command that writes.

    Attributes:
        words: Arguments, in a folder with the inputs.
        outputs: Files it writes.
    """

    words: str
    outputs: tuple[str, ...]


COMMANDS = {
    "simplify": Command(
        "simplify in/a.usda -o o.usdc --ratio 0.3 --report o.html --json o.json", ("o.usdc", "o.html", "o.json")
    ),
    "flatten": Command("simplify in/a.usda -o o.usda --ratio 0.3 --flatten --refit", ("o.usda",)),
    "levels": Command("simplify in/a.usda -o o.usda --lods 0.5,0.2", ("o.usda",)),
    "batch": Command(
        "batch in -o out --ratio 0.3 --jobs 2 --json l.jsonl", tuple(f"out/{n}" for n in ("a.usda", "b.usdc", "c.usd"))
    ),
    "build": Command("progressive build in/a.usda -o o.wpqm", ("o.wpqm",)),
    "extract": Command("progressive extract in/p.wpqm -o o.usdc --ratio 0.3", ("o.usdc",)),
    "features": Command("features in/a.usda -o o.usdc", ("o.usdc",)),
    "compare": Command("compare in/a.usda in/c.usd --heatmap o.usdc --report o.html", ("o.usdc", "o.html")),
    "render": Command("render in/a.usda -o o.png", ("o.png",)),
    "detect": Command("face detect head.usdc -o o.json --picture o.png --frames 1:3:1", ("o.json", "o.png")),
    "retarget": Command("face retarget head.usdc head.usdc -o o.usdc --frames 1:3:1", ("o.usdc",)),
    "view": Command("view in/a.usda --no-browser", ()),
}
if importlib.util.find_spec("ray") is not None:
    COMMANDS["ray"] = Command("batch in -o out --ratio 0.3 --engine ray", COMMANDS["batch"].outputs)


def make_inputs(folder: Path) -> None:
    (folder / "in").mkdir()
    cloth_stage(folder / "in/a.usda", size=24)
    cloth_stage(folder / "in/b.usdc", size=40)
    cloth_stage(folder / "in/c.usd", size=16)
    shutil.copy(ROOT / "scenes/talking_head.usdc", folder / "head.usdc")


class Trial:
    """One run of a command in a folder of its own."""

    def __init__(self, inputs: Path, name: str) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix=f"signals-{name}-"))
        shutil.copytree(inputs, self.folder, dirs_exist_ok=True)
        (self.folder / "tmp").mkdir()
        self.name, self.mark = name, os.urandom(8).hex()

    def start(self) -> subprocess.Popen[str]:
        words = COMMANDS[self.name].words.split()
        device = [] if self.name in ("extract", "build") else ["--device", "cpu"]
        return subprocess.Popen(
            [sys.executable, "-m", "warpqem", *words, *device],
            cwd=self.folder,
            env={**os.environ, MARK: self.mark, "TMPDIR": str(self.folder / "tmp")},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def processes(self) -> list[int]:
        found = []
        for entry in Path("/proc").iterdir():
            if entry.name.isdigit():
                try:
                    if f"{MARK}={self.mark}".encode() in (entry / "environ").read_bytes().split(b"\0"):
                        found.append(int(entry.name))
                except OSError:
                    pass
        return sorted(found)

    def leftovers(self) -> list[str]:
        """Hidden files beside the outputs, and all in the folder for temporary files."""
        found = [path for path in self.folder.rglob(".*") if path.name != ".warpqem-batch.jsonl"]
        # Ray keeps the logs of its sessions on purpose.
        found += [path for path in (self.folder / "tmp").iterdir() if path.name != "ray"]
        return sorted(str(path.relative_to(self.folder)) for path in found)

    def outputs(self) -> dict[str, bytes]:
        """What is there of the outputs; of those with times on them only whether they are whole."""
        found = {}
        for name in COMMANDS[self.name].outputs:
            path = self.folder / name
            if not path.exists():
                continue
            data = path.read_bytes()
            if path.suffix == ".json":
                json.loads(data)
                data = b"whole"
            elif path.suffix == ".html":
                data = b"whole" if data.rstrip().endswith(b"</html>") else b"half"
            found[name] = data
        return found

    def remove(self) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)


def parents(processes: list[int]) -> dict[int, int]:
    found = {}
    for process in processes:
        with contextlib.suppress(OSError):
            found[process] = int(Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[1])
    return found


def send(trial: Trial, process: subprocess.Popen[str], number: int, target: str) -> bool:
    """Send a signal; False where there is nobody to get it."""
    if process.poll() is not None:
        return False
    if target == "command":
        process.send_signal(number)
        return True
    if target == "group":
        os.killpg(process.pid, number)
        return True
    of = parents(trial.processes())
    work = [child for child, parent in of.items() if parent == process.pid]
    chosen = work if target == "work" else [child for child, parent in of.items() if parent in work]
    if not chosen:
        return False
    try:
        os.kill(random.choice(chosen), number)
    except ProcessLookupError:
        return False
    return True


def expected_codes(number: int, target: str, name: str) -> set[int]:
    if target == "worker":
        return {0}
    if number == signal.SIGKILL:
        return {0, -9} if target != "work" else {0, 1}
    # A command that is done already, one that has got the signal, and one that had not begun to listen.
    codes = {0, 128 + number, -number}
    return codes


def check(trial: Trial, number: int, target: str, wait: float, expected: dict[str, bytes]) -> tuple[str, list[str]]:
    """One signal; returns how it ended, and what is wrong."""
    wrong: list[str] = []
    process = trial.start()
    time.sleep(wait)
    if not send(trial, process, number, target):
        process.kill()
        process.communicate()
        return "missed", []
    begun = time.monotonic()
    if trial.name == "view" and target == "worker":
        process.kill()
    try:
        _, errors = process.communicate(timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        if trial.name != "view":
            wrong.append(f"still there after {PATIENCE:g} s")
        os.killpg(process.pid, signal.SIGKILL)
        _, errors = process.communicate()
    took = time.monotonic() - begun
    code = process.returncode
    if code not in expected_codes(number, target, trial.name):
        wrong.append(f"exit code {code}: {errors[-300:]}")
    if "Traceback" in errors or "Exception ignored" in errors:
        wrong.append(f"traceback: {errors[-600:]}")
    if code == 128 + signal.SIGINT and "interrupted" not in errors:
        wrong.append(f"does not say interrupted: {errors[-300:]}")
    end = time.monotonic() + GONE
    while trial.processes() and time.monotonic() < end:
        time.sleep(0.05)
    left = trial.processes()
    if left:
        wrong.append(f"processes left: {left}")
        for one in left:
            os.kill(one, signal.SIGKILL)
    files = trial.leftovers()
    killed_all = number == signal.SIGKILL and target == "group"
    if files and not killed_all:
        wrong.append(f"files left: {files}")
    if not trial.outputs().items() <= expected.items():
        wrong.append("an output is half or different")
    if files and trial.name != "view":
        subprocess_end = trial.start().communicate(timeout=120)
        if trial.leftovers():
            wrong.append(f"the next run leaves {trial.leftovers()}: {subprocess_end[1][-300:]}")
    return f"{code} in {took:.1f} s", wrong


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=300.0)
    parser.add_argument("--commands", default=",".join(COMMANDS))
    parser.add_argument("--signals", default=",".join(number.name for number in SIGNALS))
    parser.add_argument("--targets", default=",".join(TARGETS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep-going", action="store_true", help="Count what is wrong instead of stopping there.")
    given = parser.parse_args()
    random.seed(given.seed)
    names = given.commands.split(",")
    inputs = Path(tempfile.mkdtemp(prefix="signals-inputs-"))
    make_inputs(inputs)
    subprocess.run(
        [sys.executable, "-m", "warpqem", "progressive", "build", "in/a.usda", "-o", "in/p.wpqm"],
        cwd=inputs,
        check=True,
        capture_output=True,
    )
    seconds, expected = {}, {}
    for name in names:
        trial = Trial(inputs, name)
        begun = time.monotonic()
        process = trial.start()
        if name == "view":
            process.stdout.readline()  # type: ignore[union-attr]
            seconds[name] = time.monotonic() - begun
            process.kill()
            process.communicate()
        else:
            _, errors = process.communicate()
            assert process.returncode == 0, errors
            seconds[name] = time.monotonic() - begun
        expected[name] = trial.outputs()
        assert set(expected[name]) == set(COMMANDS[name].outputs), (name, expected[name].keys())
        assert not trial.leftovers() or name == "view", (name, trial.leftovers())
        trial.remove()
    begun = time.monotonic()
    counts: collections.Counter[str] = collections.Counter()
    problems: collections.Counter[str] = collections.Counter()
    longest = 0.0
    while time.monotonic() - begun < given.seconds:
        name = random.choice(names)
        number = signal.Signals[random.choice(given.signals.split(","))]
        target = random.choice(given.targets.split(","))
        if target == "worker" and name not in ("batch", "ray"):
            continue
        if target == "worker" and number != signal.SIGKILL:
            number = random.choice((signal.SIGKILL, signal.SIGTERM, signal.SIGHUP))
        trial = Trial(inputs, name)
        wait = random.random() * WINDOW * seconds[name]
        how, wrong = check(trial, number, target, wait, expected[name])
        trial.remove()
        if how == "missed":
            # Other work on this machine has kept the first run waiting.
            seconds[name] = min(seconds[name], wait)
            continue
        counts[f"{number.name} {target}"] += 1
        longest = max(longest, float(how.split()[2]))
        for text in wrong:
            problems[f"{number.name} {target}"] += 1
            print(f"{name} {number.name} to {target}: {how}: {text}", flush=True)
        if wrong and not given.keep_going:
            sys.exit(1)
    shutil.rmtree(inputs)
    total = sum(counts.values())
    took = time.monotonic() - begun
    print(f"{total} signals in {took:.0f} s, {sum(problems.values())} problems, longest {longest:.1f} s")
    for key, count in sorted(counts.items()):
        print(f"  {key}: {count}, {problems[key]} wrong")


if __name__ == "__main__":
    main()
