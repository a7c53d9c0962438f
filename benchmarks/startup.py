"""``startup``: wall and CPU time of the command line on a small file, kernels compiled before."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.figures import median, ratio_in_turn
from benchmarks.generated import moving_torus
from benchmarks.machine import describe_machine
from benchmarks.report import Column, Report, Table
from benchmarks.settings import Settings

__all__ = ["run", "time_process"]

FACES, FRAMES = 2000, 4
# What the command cannot do without, and does not own: the yardstick beside its time.
LIBRARIES = "import numpy, warp, pxr.UsdGeom, typer, rich.table; warp.config.log_level = warp.LOG_WARNING; warp.init()"

COLUMNS = (
    Column("what", "process"),
    Column("ratio", "time / warpqem's", ".2f"),
    Column("seconds", "s", ".3f"),
    Column("cpu_seconds", "CPU s", ".3f"),
)


def _write_stage(path: Path) -> None:
    from pxr import Gf, Usd, UsdGeom, Vt

    points, faces = moving_torus(FACES, FRAMES)
    stage = Usd.Stage.CreateNew(str(path))
    mesh = UsdGeom.Mesh.Define(stage, "/Torus")
    mesh.GetFaceVertexCountsAttr().Set(Vt.IntArray([3] * len(faces)))
    mesh.GetFaceVertexIndicesAttr().Set(Vt.IntArray.FromNumpy(faces.ravel()))
    for frame, frame_points in enumerate(points):
        mesh.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(frame_points), frame)
    mesh.GetSubdivisionSchemeAttr().Set(UsdGeom.Tokens.none)
    mesh.GetExtentAttr().Set([Gf.Vec3f(-1.0), Gf.Vec3f(1.0)])
    stage.SetDefaultPrim(mesh.GetPrim())
    stage.Save()


def time_process(command: Sequence[str]) -> tuple[float, float]:
    """Wall and CPU seconds of a process that must succeed."""
    start = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    errors = process.stderr.read() if process.stderr else b""
    _, status, usage = os.wait4(process.pid, 0)
    seconds = time.perf_counter() - start
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.stderr:
        process.stderr.close()
    if process.returncode != 0:
        raise RuntimeError(f"{' '.join(command)}: exit code {process.returncode}: {errors.decode()[-500:]}")
    return seconds, usage.ru_utime + usage.ru_stime


def run(settings: Settings) -> Report:
    """`warpqem simplify` beside a process that imports the libraries and one that does nothing, in turn."""
    report = Report("startup", "Start-up of the command line", describe_machine(["warpqem", "usd-core"]))
    with tempfile.TemporaryDirectory(prefix="warpqem-bench-") as folder:
        source, target = Path(folder) / "in.usdc", Path(folder) / "out.usdc"
        _write_stage(source)
        device = ["--device", settings.device] if settings.device else []
        simplify = ["-m", "warpqem", "simplify", str(source), "-o", str(target), "--ratio", str(settings.ratio)]
        commands = {
            "warpqem simplify": [sys.executable, *simplify, *device],
            "its libraries alone": [sys.executable, "-c", LIBRARIES],
            "python alone": [sys.executable, "-c", "pass"],
        }
        time_process(commands["warpqem simplify"])  # compiles the kernels where that has not been done
        times: dict[str, list[tuple[float, float]]] = {name: [] for name in commands}
        for _ in range(settings.turns):
            for name, command in commands.items():
                times[name].append(time_process(command))
    base = [wall for wall, _ in times["warpqem simplify"]]
    rows = [
        {
            "what": name,
            "ratio": ratio_in_turn([wall for wall, _ in both], base),
            "seconds": median([wall for wall, _ in both]),
            "cpu_seconds": median([cpu for _, cpu in both]),
            "all_seconds": [wall for wall, _ in both],
        }
        for name, both in times.items()
    ]
    report.tables.append(Table(f"A file of {FACES} faces and {FRAMES} frames, kernels compiled before", COLUMNS, rows))
    return report
