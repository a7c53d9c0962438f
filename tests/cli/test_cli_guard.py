"""The process that watches the command line's work: what native code does to that becomes an error."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

from warpqem.runtime.processes import ProcessId

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="only where processes can be forked")

PROGRAM = """
import os, signal, sys, time
from warpqem.cli.crash_guard import guarded
from warpqem.cli.signals import hold_signals
from warpqem.runtime.load_timeout import load_timeout
# As the command line does, so that no signal comes before there is a handler for it.
hold_signals()
{setup}
def work():
{work}
guarded(work)
"""


def start(work: str, setup: str = "", stdin: bool = False, **options: bool) -> subprocess.Popen[str]:
    code = PROGRAM.format(setup=setup, work="\n".join(f"    {line}" for line in work.splitlines()))
    return subprocess.Popen(
        [sys.executable, "-c", code],
        stdin=subprocess.PIPE if stdin else None,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


def run(work: str, setup: str = "") -> tuple[int, str]:
    process = start(work, setup)
    _, errors = process.communicate(timeout=60)
    return process.returncode, errors


@pytest.mark.parametrize("code", [0, 1, 2])
def test_exit_code_is_that_of_the_work(code):
    assert run(f"sys.exit({code})") == (code, "")


def test_work_that_returns_is_a_success():
    assert run("pass") == (0, "")


def test_crash_while_a_file_is_opened_names_it(tmp_path):
    code, errors = run(f"with load_timeout({str(tmp_path / 'bad.usdc')!r}):\n    os.kill(os.getpid(), signal.SIGSEGV)")
    assert code == 1
    assert f"error: {tmp_path / 'bad.usdc'}: USD crashed while it opened the file" in errors
    assert "SIGSEGV" in errors


def test_crash_at_another_time_says_how_it_came():
    code, errors = run("with load_timeout('good.usdc'):\n    pass\nos.kill(os.getpid(), signal.SIGABRT)")
    assert code == 1
    assert "error: good.usdc: crashed in native code (SIGABRT) after the file was opened" in errors


def test_crash_before_any_file_names_none():
    assert "error: crashed in native code (SIGABRT)" in run("os.kill(os.getpid(), signal.SIGABRT)")[1]


def test_file_that_never_opens_ends_in_an_error():
    code, errors = run(
        "with load_timeout('x.usdc'):\n    while True: pass",
        "import warpqem.runtime.load_timeout as o; o.MIN_SECONDS = 0.2",
    )
    assert code == 1
    assert "error: x.usdc: USD does not come to the end of it" in errors


def test_opening_that_waits_takes_no_time():
    assert (
        run(
            "with load_timeout('x.usdc'):\n    time.sleep(0.5)",
            "import warpqem.runtime.load_timeout as o; o.MIN_SECONDS = 0.2",
        )[0]
        == 0
    )


SIGNALS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT]
# Native code does not come back to Python for a signal.
NATIVE = "print('ready', flush=True)\nimport ctypes\nctypes.PyDLL(None).sleep(60)"


def stop(process: subprocess.Popen[str], number: int) -> tuple[int, str]:
    """Wait for a line, send a signal; returns the exit code and what was said."""
    process.stdout.readline()
    process.send_signal(number)
    _, errors = process.communicate(timeout=20)
    return process.returncode, errors


def said(number: int) -> str:
    return "error: interrupted\n" if number == signal.SIGINT else f"error: stopped by {signal.Signals(number).name}\n"


@pytest.mark.parametrize("number", SIGNALS)
def test_signal_ends_native_code_at_once(number):
    assert stop(start(NATIVE), number) == (128 + number, said(number))


@pytest.mark.parametrize("number", SIGNALS)
def test_signal_that_only_the_work_gets_ends_the_command_alike(number):
    work = f"os.kill(os.getpid(), {int(number)})\ntime.sleep(60)"
    assert run(work) == (128 + number, said(number))


@pytest.mark.parametrize("number", SIGNALS)
def test_signal_that_comes_before_there_is_any_work_is_not_lost(number):
    setup = f"os.kill(os.getpid(), {int(number)})"
    assert run("time.sleep(60)", setup) == (128 + number, said(number))


@pytest.mark.parametrize("number", SIGNALS)
def test_signal_that_is_ignored_from_the_start_stays_ignored(number):
    process = start("print('ready', flush=True)\ninput()", f"signal.signal({int(number)}, signal.SIG_IGN)", stdin=True)
    process.stdout.readline()
    process.send_signal(number)
    time.sleep(0.1)
    process.communicate("\n", timeout=20)
    assert process.returncode == 0


# Short sleeps: a signal just before a long one would not be looked at until its end.
INTERRUPTIBLE = """
from warpqem.cli.crash_guard import interruptible
with interruptible():
    try:
        print('ready', flush=True)
        for _ in range(6000):
            time.sleep(0.01)
    except KeyboardInterrupt:
        {then}
"""


@pytest.mark.parametrize("number", SIGNALS)
def test_work_that_has_something_to_say_says_it(number):
    work = INTERRUPTIBLE.format(then="print('half done', file=sys.stderr); sys.exit(1)")
    assert stop(start(work), number) == (128 + number, "half done\n")


def test_work_that_is_meant_to_be_interrupted_is_a_success_then():
    assert stop(start(INTERRUPTIBLE.format(then="pass")), signal.SIGINT) == (0, "")


def test_work_that_is_meant_to_be_interrupted_is_none_when_it_is_stopped():
    assert stop(start(INTERRUPTIBLE.format(then="pass")), signal.SIGTERM)[0] == 128 + signal.SIGTERM


def test_work_that_does_not_end_by_itself_is_ended():
    process = start(
        INTERRUPTIBLE.format(then="time.sleep(60)"), "import warpqem.cli.crash_guard as g; g.END_SECONDS = 0.3"
    )
    assert stop(process, signal.SIGTERM) == (128 + signal.SIGTERM, said(signal.SIGTERM))


def test_second_interrupt_ends_work_at_once():
    process = start(INTERRUPTIBLE.format(then="print('more', flush=True); time.sleep(60)"))
    process.stdout.readline()
    process.send_signal(signal.SIGINT)
    process.stdout.readline()
    time.sleep(0.6)
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=20) == 130


def test_interrupt_of_the_terminal_is_one_though_both_processes_get_it():
    work = INTERRUPTIBLE.format(then="time.sleep(0.3); print('half done', file=sys.stderr); sys.exit(1)")
    process = start(work, start_new_session=True)
    process.stdout.readline()
    os.killpg(process.pid, signal.SIGINT)
    assert (process.communicate(timeout=20)[1], process.returncode) == ("half done\n", 130)


LEFTOVERS = """
import subprocess
from pathlib import Path
from warpqem.runtime.processes import note_process
from warpqem.files.temporary import temporary_path
temporary_path(Path({folder!r}), '.usdc').touch()
worker = subprocess.Popen(['sleep', '60'])
note_process(worker.pid)
print(worker.pid, flush=True)
time.sleep(60)
"""


def wait_until(found) -> None:
    end = time.monotonic() + 20
    while not found():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.parametrize("number", [*SIGNALS, signal.SIGKILL])
def test_workers_and_temporary_files_go(tmp_path, number):
    process = start(LEFTOVERS.format(folder=str(tmp_path)))
    worker = ProcessId.of(int(process.stdout.readline()))
    assert len(os.listdir(tmp_path)) == 1
    process.send_signal(number)
    process.communicate(timeout=20)
    # A watcher that was killed leaves that to another process.
    wait_until(lambda: not worker.is_alive() and not os.listdir(tmp_path))


@pytest.mark.parametrize("code", [0, 1])
def test_output_that_nobody_reads_does_not_stop_the_work(tmp_path, code):
    work = f"print('x' * 10**6, flush=True)\nopen({str(tmp_path / 'done')!r}, 'w').close()\nsys.exit({code})"
    process = start(work)
    process.stdout.close()
    assert process.wait(timeout=20) == (code or 128 + signal.SIGPIPE)
    assert process.stderr.read() == ""
    assert (tmp_path / "done").exists()


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no device that is full")
@pytest.mark.parametrize("flush", [False, True])
def test_output_to_a_full_disk_is_an_error_once_the_work_is_done(tmp_path, flush):
    work = f"    print('x', flush={flush})\n    open({str(tmp_path / 'done')!r}, 'w').close()"
    command = [sys.executable, "-c", PROGRAM.format(setup="", work=work)]
    buffered = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, env=buffered)
    assert done.returncode == 1
    assert done.stderr == "error: standard output: cannot be written (No space left on device)\n"
    assert (tmp_path / "done").exists()


def test_work_ends_with_its_watcher():
    process = start("print(os.getpid(), flush=True)\ntime.sleep(60)")
    assert process.stdout is not None
    child = int(process.stdout.readline())
    process.kill()
    process.wait()
    for _ in range(200):
        try:
            os.kill(child, 0)
        except ProcessLookupError:
            return
        time.sleep(0.05)
    raise AssertionError("the work goes on")


def test_process_that_nobody_watches_has_no_limit():
    code = (
        "import warpqem.runtime.load_timeout as o; o.MIN_SECONDS = 0.1\n"
        "with o.load_timeout('x'):\n    sum(range(30_000_000))"
    )
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0
