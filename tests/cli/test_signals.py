"""Signals to commands that are writing, and to batches: exit codes, and what is left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tests.support.usd_stages import cloth_stage
from warpqem.runtime.processes import ProcessId

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="signals, and processes by their start")

# The program, with output files that are never finished: it says so, and is stuck in native code.
STUCK = """
import ctypes, sys
import warpqem.picture.sheet, warpqem.usd.write.layer_files

def stuck(*_, **__):
    open("writing", "w").close()
    ctypes.PyDLL(None).sleep(60)

warpqem.usd.write.layer_files.make_readable = stuck
warpqem.files.temporary.os.replace = stuck
sys.argv[0] = "warpqem"
from warpqem.cli.main import run
run()
"""
COMMANDS = {
    "simplify": "simplify in.usda -o out.usdc --ratio 0.5 --device cpu",
    "render": "render in.usda -o out.png --device cpu --size 32x32",
}
CASES = [
    ("simplify", signal.SIGINT),
    ("simplify", signal.SIGTERM),
    ("render", signal.SIGHUP),
    ("render", signal.SIGQUIT),
]


def start(folder: Path, command: str, program: str | None = None) -> subprocess.Popen[str]:
    """A command in a process group of its own."""
    given = ["-m", "warpqem"] if program is None else ["-c", program]
    return subprocess.Popen(
        [sys.executable, *given, *command.split()],
        cwd=folder,
        env={**os.environ, "TMPDIR": str(folder / "tmp")},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def make_folder(folder: Path, name: str = "in.usda") -> Path:
    (folder / "tmp").mkdir(parents=True)
    cloth_stage(folder / name)
    return folder


def wait_for(found) -> None:
    end = time.monotonic() + 60
    while not found():
        assert time.monotonic() < end
        time.sleep(0.02)


def hidden(folder: Path) -> list[str]:
    """Temporary files beside outputs, and all in the folder for temporary files."""
    found = [path for path in folder.rglob(".warpqem.*") if path.parent.name != "tmp"]
    return sorted(map(str, [*found, *(folder / "tmp").iterdir()]))


@dataclass
class Stopped:
    """What came of commands that got a signal while they were writing, all at the same time."""

    codes: dict[tuple[str, int], int] = field(default_factory=dict)
    errors: dict[tuple[str, int], str] = field(default_factory=dict)
    left: dict[tuple[str, int], list[str]] = field(default_factory=dict)


@pytest.fixture(scope="module")
def stopped(tmp_path_factory) -> Stopped:
    found = Stopped()
    folders = {case: make_folder(tmp_path_factory.mktemp(case[0])) for case in CASES}
    processes = {case: start(folders[case], COMMANDS[case[0]], STUCK) for case in CASES}
    for (name, number), process in processes.items():
        case, folder = (name, number), folders[name, number]
        wait_for((folder / "writing").exists)
        assert hidden(folder)
        process.send_signal(number)
        _, found.errors[case] = process.communicate(timeout=20)
        found.codes[case] = process.returncode
        found.left[case] = sorted(set(os.listdir(folder)) - {"in.usda", "tmp", "writing"})
    return found


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case[0]} {signal.Signals(case[1]).name}")
def test_command_that_is_writing_ends_and_leaves_nothing(stopped, case):
    number = case[1]
    assert stopped.codes[case] == 128 + number
    reason = "interrupted" if number == signal.SIGINT else f"stopped by {signal.Signals(number).name}"
    assert stopped.errors[case].endswith(f"error: {reason}\n")
    assert stopped.left[case] == []


def test_what_a_killed_command_left_the_next_one_removes(tmp_path):
    process = start(make_folder(tmp_path), COMMANDS["simplify"], STUCK)
    wait_for((tmp_path / "writing").exists)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    assert hidden(tmp_path)
    following = start(tmp_path, COMMANDS["simplify"])
    assert following.wait(timeout=60) == 0, following.stderr.read()
    assert hidden(tmp_path) == []
    assert (tmp_path / "out.usdc").exists()


def workers_of(process: int) -> list[ProcessId]:
    """Children of children."""

    def children(of: set[int]) -> set[int]:
        found = subprocess.run(["ps", "-eo", "pid=,ppid="], capture_output=True, text=True, check=True).stdout
        return {int(pid) for pid, parent in (line.split() for line in found.splitlines()) if int(parent) in of}

    return [ProcessId.of(number) for number in children(children({process}))]


@pytest.mark.parametrize(("number", "whole_group"), [(signal.SIGINT, True), (signal.SIGTERM, False)])
def test_batch_that_is_stopped_leaves_no_worker_and_no_file(tmp_path, number, whole_group):
    make_folder(tmp_path / "at")
    trapped = "from tests.support.batch_traps import Path, hang_while_writing; hang_while_writing('writing')"
    # Workers of this interpreter are caught while they write: they load this before anything else.
    is_worker = "'spawn_main' in ' '.join(sys.orig_argv)"
    (tmp_path / "at" / "sitecustomize.py").write_text(f"import sys\nif {is_worker}: {trapped}")
    path = os.pathsep.join([str(tmp_path / "at"), str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")])
    before, os.environ["PYTHONPATH"] = os.environ.get("PYTHONPATH"), path
    try:
        process = start(tmp_path / "at", "batch in.usda -o out --ratio 0.5 --device cpu --jobs 1")
    finally:
        os.environ.pop("PYTHONPATH")
        if before is not None:
            os.environ["PYTHONPATH"] = before
    wait_for((tmp_path / "at" / "writing").exists)
    workers = workers_of(process.pid)
    assert workers
    assert hidden(tmp_path / "at")
    (os.killpg if whole_group else os.kill)(process.pid, number)
    _, errors = process.communicate(timeout=30)
    wait_for(lambda: not any(worker.is_alive() for worker in workers) and not hidden(tmp_path / "at"))
    assert process.returncode == 128 + number
    assert "error: interrupted after 0 of 1 assets; go on with --resume\n" in errors
    assert "Traceback" not in errors


# A program that uses the Python interface, gets Ctrl-C, and keeps the error, and with it the iterator.
HOST = """
import signal, sys
import warpqem
from tests.support.batch_traps import TrapOptions
from pathlib import Path

def main():
    handlers = {number: signal.getsignal(number) for number in signal.valid_signals()}
    options = TrapOptions(ratio=0.5, device="cpu", trap="hang while writing", marker="writing")
    updates = warpqem.batch([warpqem.BatchJob("in.usda", "out.usdc", options)])
    try:
        for result in updates:
            print(result)
    except KeyboardInterrupt as error:
        kept = error
        assert handlers == {number: signal.getsignal(number) for number in signal.valid_signals()}
        print("interrupted", flush=True)
        raise

if __name__ == "__main__":
    main()
"""


def test_program_that_is_interrupted_keeps_its_handlers_and_leaves_nothing(tmp_path):
    make_folder(tmp_path)
    (tmp_path / "host.py").write_text(HOST)
    environment = {**os.environ, "TMPDIR": str(tmp_path / "tmp"), "PYTHONPATH": os.pathsep.join(sys.path)}
    process = subprocess.Popen(
        [sys.executable, "host.py"],
        cwd=tmp_path,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    wait_for((tmp_path / "writing").exists)
    assert hidden(tmp_path)
    os.killpg(process.pid, signal.SIGINT)
    output, errors = process.communicate(timeout=30)
    assert output.endswith("interrupted\n")
    assert errors.count("Traceback") == 1  # its own
    assert hidden(tmp_path) == []


def test_iterator_that_is_kept_past_an_error_leaves_nothing_when_the_program_ends(tmp_path):
    make_folder(tmp_path)
    code = HOST.replace("for result in updates:", "for result in [1]:").replace("print(result)", "next_one(updates)")
    code = code.replace(
        "def main():",
        "from threading import Thread\n"
        "import time\n"
        "kept = []\n"
        "def next_one(updates):\n"
        "    kept.append(updates)\n"
        "    Thread(target=lambda: next(updates), daemon=True).start()\n"
        "    while not Path('writing').exists():\n"
        "        time.sleep(0.02)\n"
        "    raise KeyboardInterrupt\n"
        "def main():",
    )
    (tmp_path / "host.py").write_text(code)
    environment = {**os.environ, "TMPDIR": str(tmp_path / "tmp"), "PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run([sys.executable, "host.py"], cwd=tmp_path, env=environment, timeout=60, capture_output=True)
    assert (tmp_path / "writing").exists()
    assert hidden(tmp_path) == []
