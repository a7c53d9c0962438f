"""What comes of a limit of the process (ulimit) is laid to the limit, not to a file."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from signal import Signals

import pytest

from tests.support.usd_stages import cloth_stage
from warpqem.cli.crash_guard import _reason
from warpqem.errors import MemoryLimitError, ProcessLimitError, StageError
from warpqem.runtime.process_limits import check_limits, limit_behind_error, limit_behind_signal, with_limit

resource = pytest.importorskip("resource")
MIB = 2**20


@pytest.fixture
def limits(monkeypatch) -> dict[str, int]:
    """Limits by name; those that are not in it are infinite."""
    values: dict[str, int] = {}
    numbers = {getattr(resource, name): name.removeprefix("RLIMIT_") for name in dir(resource) if "RLIMIT_" in name}
    numbers[resource.RLIMIT_NOFILE] = "NOFILE"  # which has another name, too
    infinity = resource.RLIM_INFINITY
    monkeypatch.setattr(resource, "getrlimit", lambda number: (values.get(numbers[number], infinity),) * 2)
    return values


@pytest.mark.parametrize(
    ("limit", "error", "words"),
    [
        ({"AS": 800 * MIB}, MemoryError(), "address space is limited to 800M for this process (ulimit -v)"),
        ({"AS": 800 * MIB}, ImportError("x.so: failed to map segment from shared object"), "(ulimit -v)"),
        (
            {"NOFILE": 20},
            OSError(errno.EMFILE, "Too many"),
            "open files are limited to 20 for this process (ulimit -n)",
        ),
        ({"NOFILE": 20}, StageError("a.usda: cannot be read (Too many open files)"), "(ulimit -n)"),
        ({"FSIZE": 100}, OSError(errno.EFBIG, "large"), "the size of a file is limited to 100 bytes"),
        ({"FSIZE": 100}, StageError("Error occurred writing file: File too large"), "(ulimit -f)"),
        ({"NPROC": 5}, RuntimeError("can't start new thread"), "processes and threads are limited to 5"),
    ],
)
def test_error_is_laid_to_its_limit(limits, limit, error, words):
    assert limit_behind_error(error) == ""
    limits.update(limit)
    assert words in limit_behind_error(error)
    outer = StageError("a.usda: cannot be read")
    outer.__cause__ = error
    assert with_limit("a.usda", outer) == f"a.usda; {limit_behind_error(error)}"


@pytest.mark.parametrize(
    "error", [StageError("a.usda: no such file"), MemoryLimitError("a plan needs 2G"), KeyError(1)]
)
def test_other_errors_have_no_limit_behind_them(limits, error):
    limits.update(AS=MIB, NOFILE=1, FSIZE=1, STACK=1)
    assert limit_behind_error(error) == ""


@pytest.mark.parametrize(
    ("limit", "signal", "flag"),
    [
        ({"STACK": MIB}, "SIGSEGV", "-s"),
        ({"AS": 2**30}, "SIGABRT", "-v"),
        ({"FSIZE": 10}, "SIGXFSZ", "-f"),
        ({"CPU": 1}, "SIGKILL", "-t"),
    ],
)
@pytest.mark.parametrize("load_timeout", [True, False])
def test_signal_is_laid_to_its_limit_and_not_to_the_file(limits, limit, signal, flag, load_timeout):
    limits.update(limit)
    text = _reason(Signals[signal].value, "a.usdc", load_timeout)
    assert text.startswith(f"a.usdc: ended by {signal}")
    assert f"(ulimit {flag})" in text
    assert "damaged" not in text


def test_usual_limits_are_no_reason(limits):
    limits.update(STACK=8 * MIB, NOFILE=1024, AS=2**36)
    assert limit_behind_signal("SIGSEGV") == ""
    assert "damaged" in _reason(Signals.SIGSEGV.value, "a.usdc", True)


@pytest.mark.parametrize(
    ("limit", "flag"), [({"AS": 100 * MIB}, "-v"), ({"STACK": 2**16}, "-s"), ({"NOFILE": 4}, "-n")]
)
def test_what_cannot_even_start_is_refused(limits, limit, flag):
    check_limits()
    limits.update(limit)
    with pytest.raises(ProcessLimitError, match=rf"\(ulimit {flag}\); nothing can be done with less than"):
        check_limits()


@pytest.mark.skipif(sys.platform != "linux", reason="the sizes are those of Linux")
@pytest.mark.parametrize(
    ("limit", "flag"),
    [(("RLIMIT_AS", 300 * MIB), "-v"), (("RLIMIT_STACK", 2**17), "-s"), (("RLIMIT_FSIZE", 500), "-f")],
)
def test_program_names_the_limit(tmp_path, limit, flag):
    cloth_stage(tmp_path / "in.usda")
    number = getattr(resource, limit[0])
    process = subprocess.run(
        [
            *(sys.executable, "-m", "warpqem", "simplify", "in.usda", "-o", "o.usda"),
            *("--ratio", "0.5", "--device", "cpu"),
        ],
        cwd=tmp_path,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        preexec_fn=lambda: resource.setrlimit(number, (limit[1], resource.getrlimit(number)[1])),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert process.returncode == 1
    [error] = [line for line in process.stderr.splitlines() if line.startswith("error: ")]
    assert f"(ulimit {flag})" in error
    assert "damaged" not in error
    assert not (tmp_path / "o.usda").exists()
