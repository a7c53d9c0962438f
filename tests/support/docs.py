"""Commands and Python of the documentation, run as a reader would."""

from __future__ import annotations

import shlex
import shutil
import subprocess
from pathlib import Path

import pytest
from typer.testing import CliRunner

from warpqem.cli.main import app

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def desk(tmp_path, monkeypatch):
    """A folder with the shipped scenes; `view` ends at once, as if it had been interrupted."""
    for scene in (ROOT / "scenes").glob("*.usdc"):
        shutil.copy(scene, tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("warpqem.report.server.PageServer.serve", lambda server: server._server.server_close())
    monkeypatch.setattr("webbrowser.open", lambda address: None)
    return tmp_path


def run_line(line: str) -> None:
    program, *arguments = shlex.split(line)
    if program == "warpqem":
        done = CliRunner().invoke(app, arguments)
        assert done.exit_code == 0, f"{line}\n{done.output}"
    else:
        subprocess.run(line, shell=True, check=True, executable="/bin/bash")
