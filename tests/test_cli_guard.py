"""The process that watches the command line's work: what native code does to that becomes an error."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="only where processes can be forked")

PROGRAM = """
import os, signal, sys, time
from warpqem.cli.guard import guarded
from warpqem.opening import opening
{setup}
def work():
{work}
guarded(work)
"""


def start(work: str, setup: str = "") -> subprocess.Popen[str]:
    code = PROGRAM.format(setup=setup, work="\n".join(f"    {line}" for line in work.splitlines()))
    return subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


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
    code, errors = run(f"with opening({str(tmp_path / 'bad.usdc')!r}):\n    os.kill(os.getpid(), signal.SIGSEGV)")
    assert code == 1
    assert f"error: {tmp_path / 'bad.usdc'}: USD crashed while it opened the file" in errors
    assert "SIGSEGV" in errors


def test_crash_at_another_time_says_how_it_came():
    code, errors = run("with opening('good.usdc'):\n    pass\nos.kill(os.getpid(), signal.SIGABRT)")
    assert code == 1
    assert "error: good.usdc: crashed in native code (SIGABRT) after the file was opened" in errors


def test_crash_before_any_file_names_none():
    assert "error: crashed in native code (SIGABRT)" in run("os.kill(os.getpid(), signal.SIGABRT)")[1]


def test_file_that_never_opens_ends_in_an_error():
    code, errors = run(
        "with opening('x.usdc'):\n    while True: pass", "import warpqem.opening as o; o.LEAST_SECONDS = 0.2"
    )
    assert code == 1
    assert "error: x.usdc: USD does not come to the end of it" in errors


def test_opening_that_waits_takes_no_time():
    assert (
        run("with opening('x.usdc'):\n    time.sleep(0.5)", "import warpqem.opening as o; o.LEAST_SECONDS = 0.2")[0]
        == 0
    )


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_is_passed_on(number):
    process = start("print('ready', flush=True)\ntime.sleep(60)")
    assert process.stdout is not None
    process.stdout.readline()
    process.send_signal(number)
    assert process.wait(timeout=20) == 1


def test_second_interrupt_ends_work_that_does_not_listen():
    process = start("signal.signal(signal.SIGINT, signal.SIG_IGN)\nprint('ready', flush=True)\ntime.sleep(60)")
    assert process.stdout is not None
    process.stdout.readline()
    process.send_signal(signal.SIGINT)
    time.sleep(0.7)
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=20) == 1


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
    code = "import warpqem.opening as o; o.LEAST_SECONDS = 0.1\nwith o.opening('x'):\n    sum(range(30_000_000))"
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0
