"""compute-sanitizer on a small mesh: accesses out of bounds, races, barriers that not all threads reach."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

from benchmarks.device.findings import Findings
from benchmarks.work import torus_work

__all__ = ["find_sanitizer", "main", "run"]

# Cheap first: each tool makes kernels tens of times slower.
TOOLS = ("memcheck", "synccheck", "racecheck")
FACES, FRAMES = 1500, 4
# What it returns where it has found something: no exit code of Python.
FOUND = 99


def find_sanitizer() -> Path | None:
    """The program, on PATH or with a CUDA toolkit; None where there is none."""
    on_path = shutil.which("compute-sanitizer")
    toolkits = [Path(os.environ[name]) for name in ("CUDA_HOME", "CUDA_PATH") if name in os.environ]
    toolkits += sorted(Path("/usr/local").glob("cuda*"), reverse=True)
    candidates = [Path(on_path)] if on_path else [folder / "bin" / "compute-sanitizer" for folder in toolkits]
    return next((file for file in candidates if file.exists()), None)


def run(found: Findings) -> None:
    """Each tool on the whole pipeline, launch by launch."""
    program = find_sanitizer()
    if program is None:
        found.left_out("compute-sanitizer", "not found on PATH or below CUDA_HOME, /usr/local/cuda*")
        return
    for tool in TOOLS:
        command = [str(program), "--tool", tool, "--error-exitcode", str(FOUND), sys.executable, "-m", __name__]
        done = subprocess.run([*command, found.device], capture_output=True, text=True, check=False)
        lines = [line for line in (done.stdout + done.stderr).splitlines() if line.strip()]
        summary = next((line for line in reversed(lines) if "SUMMARY" in line), lines[-1] if lines else "no output")
        found.expect(tool, f"exit code {done.returncode}, {summary.strip('= ')}", "0 errors", done.returncode == 0)


def main(device: str) -> None:
    """What the tools look at: without graphs, so that they name the kernel."""
    import warp as wp

    import warpqem
    import warpqem.runtime.device as devices

    wp.config.log_level = wp.LOG_WARNING
    kind = "cpu" if wp.get_device(device).is_cpu else "cuda"
    devices._TRAITS[kind] = replace(devices._TRAITS[kind], captures=False)
    work = torus_work(FACES, FRAMES, 0.3)
    for quality in ("fast", "best"):
        warpqem.simplify(work.points, work.faces, target_faces=work.target_faces, quality=quality, device=device)


if __name__ == "__main__":
    main(*sys.argv[1:])
