"""The progress of commands: shown from the beginning, with what is done, faces, frames and the time that is left."""

from __future__ import annotations

import io
import os
import subprocess
import sys

import pytest
from rich.console import Console

from tests.support import meshes
from tests.support.usd_stages import cloth_stage, define_cloth
from warpqem import simplify
from warpqem.cli import messages
from warpqem.cli.progress_bar import progress_bar
from warpqem.runtime import compiling
from warpqem.runtime.compiling import compile_listener
from warpqem.usd import SimplifyOptions, simplify_stage


@pytest.fixture
def terminal(monkeypatch):
    """What is shown on a terminal of 80 columns."""
    file = io.StringIO()
    console = Console(file=file, width=80, force_terminal=True, color_system=None)
    monkeypatch.setattr("warpqem.cli.progress_bar.Console", lambda stderr: console)
    return file


def test_the_bar_is_there_before_anything_is_done(terminal):
    with progress_bar("loading") as _:
        pass
    first = terminal.getvalue()
    assert "loading" in first
    assert "0%" in first
    assert "-:--:--" in first


def test_a_line_holds_the_text_and_is_cut_where_it_is_too_long(terminal):
    with progress_bar("loading") as progress:
        progress(0.5, "Body: " + "collapsing edges, " * 20)
    lines = terminal.getvalue().replace("\r", "\n").splitlines()
    assert any("Body: collapsing edges" in line and line.rstrip().endswith("…") for line in lines)


def test_quiet_shows_no_bar(terminal, monkeypatch):
    monkeypatch.setattr(messages, "quiet", True)
    with progress_bar("loading") as progress:
        progress(0.5, "half")
    assert terminal.getvalue() == ""


def test_a_mesh_is_shown_with_its_step_its_faces_and_its_frames(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda", times=[1.0, 2.0, 3.0])
    define_cloth(stage, "/Root/Other")
    stage.Save()
    seen = []
    options = SimplifyOptions(ratio=0.3, device="cpu")
    simplify_stage(
        tmp_path / "in.usda", tmp_path / "out.usda", options, progress=lambda part, text: seen.append((part, text))
    )
    steps = ("reading its frames", "collapsing edges", "placing vertices", "writing the simplified mesh", "measuring")
    expected = [f"Cloth (1 of 2): {step}, 128 faces x 3 frames" for step in steps]
    assert [text for text in dict.fromkeys(text for _, text in seen) if text.startswith("Cloth")] == expected
    parts = [part for part, _ in seen]
    assert parts == sorted(parts)
    # Measuring takes its share of the time.
    assert 0.3 < next(part for part, text in seen if "measuring" in text) < 0.5


def test_compiling_is_known_before_it_begins_and_only_where_there_is_no_code(tmp_path):
    environment = {**os.environ, "WARP_CACHE_PATH": str(tmp_path)}
    code = """
import warp as wp
import warpqem.runtime.launches as launches
from warpqem.runtime.compiling import compile_listener
from warpqem.kernels import topology
kernel = next(value for value in vars(topology).values() if isinstance(value, wp.Kernel))
with compile_listener(lambda begins: print("compiling" if begins else "compiled")):
    launches.load_kernel(kernel, "cpu")
    launches.load_kernel(kernel, "cpu")
"""
    for expected in (["compiling", "compiled"], []):
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
        assert done.stdout.split() == expected


def test_nothing_is_said_of_kernels_that_are_compiled():
    simplify(*meshes.icosphere(2), ratio=0.5, device="cpu")
    with compile_listener(lambda begins: pytest.fail("compiled again")):
        simplify(*meshes.icosphere(2), ratio=0.5, device="cpu")


def test_without_a_terminal_a_note_says_once_that_kernels_are_compiled(capsys):
    with progress_bar("loading"):
        for begins in (True, False, True, False):
            for listen in compiling._listeners:
                listen(begins)
    assert capsys.readouterr().err == (
        "note: compiling the kernels, which takes a minute or two the first time on a device\n"
    )
