"""Warp says nothing while it starts and loads kernels, unless it was asked to."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import warp as wp

from warpqem.runtime.warp_messages import NO_DRIVER, quiet_loading, quiet_start

ROOT = Path(__file__).resolve().parents[2]
CODE = """
import warpqem
from tests.support import meshes
print(len(warpqem.simplify(*meshes.icosphere(2), ratio=0.5, device="cpu").faces))
"""


class Logger:
    """One that a program has set."""

    def debug(self, message): ...

    def info(self, message): ...

    def warning(self, message, category=None, stacklevel=1): ...

    def error(self, message): ...


def said(code: str) -> tuple[str, str]:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    return done.stdout, done.stderr


def test_simplifying_prints_nothing():
    assert said(CODE) == ("160\n", "")


def test_asking_for_free_memory_prints_nothing():
    code = "from warpqem.runtime.memory import available_memory\navailable_memory('cpu')"
    assert said(code) == ("", "")


def test_what_the_caller_has_asked_warp_for_stays():
    assert "Module warpqem.kernels" in said("import warp as wp\nwp.config.log_level = wp.LOG_DEBUG\n" + CODE)[0]


def test_other_lines_on_stderr_are_kept_while_warp_starts(capfd):
    with quiet_start():
        os.write(2, b"before\nWarp CUDA warning: " + NO_DRIVER + b". And so on.\nafter")
    assert capfd.readouterr().err == "before\nafter"


def test_stderr_is_back_after_an_error(capfd):
    with pytest.raises(RuntimeError), quiet_start():
        raise RuntimeError
    os.write(2, b"here")
    assert capfd.readouterr().err == "here"


@pytest.mark.parametrize("own_logger", [False, True])
@pytest.mark.parametrize("level", [wp.LOG_DEBUG, wp.LOG_INFO, wp.LOG_ERROR])
def test_the_log_level_is_raised_where_it_is_the_default_and_set_back(monkeypatch, level, own_logger):
    before = wp.get_logger()
    monkeypatch.setattr(wp.config, "log_level", level)
    wp.set_logger(Logger() if own_logger else None)
    try:
        with quiet_loading():
            assert wp.config.log_level == (level if own_logger or level != wp.LOG_INFO else wp.LOG_WARNING)
        assert wp.config.log_level == level
    finally:
        wp.set_logger(before)
