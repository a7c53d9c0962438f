"""Commands and Python of the documentation, run as a reader would."""

from __future__ import annotations

import shlex
import subprocess
from pathlib import Path

import pytest
from pxr import Sdf
from typer.testing import CliRunner

from warpqem.cli.main import app

ROOT = Path(__file__).resolve().parents[2]


# Frames that the clips on a desk keep: what a command does with a frame, it does with the next one.
DESK_FRAMES = 6


def shorten(path: Path, target: Path, frames: int) -> None:
    """Write a scene with the first frames of its clip alone; all else is as it was."""
    layer = Sdf.Layer.FindOrOpen(str(path))
    last = layer.startTimeCode + frames - 1
    short = Sdf.Layer.CreateAnonymous(".usdc")
    short.TransferContent(layer)
    for time in short.ListAllTimeSamples():
        if time > last:
            short.Traverse("/", lambda at, time=time: _erase(short, at, time))
    short.endTimeCode = last
    assert short.Export(str(target))


def _erase(layer: Sdf.Layer, path: Sdf.Path, time: float) -> None:
    if path.IsPropertyPath():
        layer.EraseTimeSample(path, time)


@pytest.fixture
def desk(tmp_path, monkeypatch):
    """A folder with the shipped scenes, of each the first frames; `view` ends at once, as if it were interrupted."""
    for scene in (ROOT / "scenes").glob("*.usdc"):
        shorten(scene, tmp_path / scene.name, DESK_FRAMES)
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
