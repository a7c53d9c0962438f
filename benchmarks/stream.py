"""``stream``: memory of the command line on long clips and on a large mesh, and whether blocks change a bit."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks.generated import MovingTorus
from benchmarks.machine import describe_machine
from benchmarks.report import Column, Report, Row, Table
from benchmarks.settings import Settings

__all__ = ["ProcessCost", "run", "run_process", "write_clip"]

PRIM = "/Torus"
# Faces and frames of the clips. The last is the large mesh.
CLIPS = ((10_000, 50), (10_000, 500), (10_000, 5000), (1_000_000, 48))
QUICK_CLIPS = ((1000, 8), (1000, 80), (4000, 8))
# Clips with no more coordinates than this are also done in one block from arrays, to compare every bit.
MAX_COMPARED = 10**8
# USD maps a binary file into memory, and the pages of it that were read count as the process's, though the system takes
# them back when it needs them. With this variable USD reads instead, and what is left is what warpqem decides.
READ_VARIABLE = "USDC_USE_PREAD"
# Samples are saved to a clip when there are so many bytes of them.
UNSAVED_BYTES = 32 * 2**20
POLL_SECONDS = 0.01

COLUMNS = (
    Column("faces", "faces", "d"),
    Column("frames", "frames", "d"),
    Column("file_mb", "file MB", ".0f"),
    Column("access", "file is"),
    Column("peak_mb", "peak MB", ".0f"),
    Column("private_mb", "of it private MB", ".0f"),
    Column("seconds", "s", ".1f"),
    Column("cpu_seconds", "CPU s", ".1f"),
    Column("ns", "CPU ns / face / frame", ".0f"),
    Column("same_bits", "bits of arrays"),
)


@dataclass(frozen=True)
class ProcessCost:
    """What a process took: ``private_mb`` is its peak without mapped files; None where the system does not say."""

    seconds: float
    cpu_seconds: float
    peak_mb: float | None
    private_mb: float | None


def run_process(command: Sequence[str], environment: dict[str, str]) -> ProcessCost:
    """Run a process that must succeed, and watch its memory."""
    start = time.perf_counter()
    with tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=errors, env={**os.environ, **environment})
        peaks: dict[str, float] = {}
        watcher = threading.Thread(target=_watch, args=(process.pid, peaks))
        watcher.start()
        _, status, usage = os.wait4(process.pid, 0)
        seconds = time.perf_counter() - start
        watcher.join()
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode != 0:
            errors.seek(0)
            text = " ".join(errors.read().decode()[-500:].split())
            raise RuntimeError(f"{' '.join(command)}: exit code {process.returncode}: {text}")
    return ProcessCost(seconds, usage.ru_utime + usage.ru_stime, peaks.get("VmHWM"), peaks.get("RssAnon"))


def _watch(pid: int, peaks: dict[str, float]) -> None:
    """Keep the most memory of a process in MB, until it ends: all of it, and what is private.

    What ``wait4`` says would count its parent, too, as it was when the process was started.
    """
    while True:
        try:
            lines = Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines()
        except OSError:
            return
        wanted = [line.split() for line in lines if line.startswith(("VmHWM:", "RssAnon:"))]
        found = {name.rstrip(":"): int(kilobytes) / 2**10 for name, kilobytes, _ in wanted}
        if not found:
            return
        for name, size in found.items():
            peaks[name] = max(size, peaks.get(name, 0.0))
        time.sleep(POLL_SECONDS)


def write_clip(path: Path, face_count: int, frame_count: int) -> MovingTorus:
    """Write a moving torus as point samples, without ever holding all of them."""
    from pxr import Sdf, Usd, UsdGeom, Vt

    torus = MovingTorus(face_count, frame_count)
    layer = Sdf.Layer.CreateNew(os.fspath(path))
    stage = Usd.Stage.Open(layer)
    mesh = UsdGeom.Mesh.Define(stage, PRIM)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(torus.faces), 3, dtype=np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(torus.faces.ravel()))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    points, unsaved = mesh.CreatePointsAttr().GetPath(), 0
    stage.SetDefaultPrim(mesh.GetPrim())
    for frame in range(frame_count):
        pose = torus.pose(frame)
        layer.SetTimeSample(points, float(frame), Vt.Vec3fArray.FromNumpy(pose))
        unsaved += pose.nbytes
        if unsaved > UNSAVED_BYTES:
            layer.Save()
            unsaved = 0
    layer.Save()
    return torus


def _same_bits(torus: MovingTorus, output: Path, settings: Settings) -> bool | None:
    """Whether the points in a file are those that arrays in one piece give; None for clips too large for that."""
    from pxr import Usd, UsdGeom

    import warpqem

    if 3 * torus.vertex_count * torus.frame_count > MAX_COMPARED:
        return None
    points = np.stack([torus.pose(frame) for frame in range(torus.frame_count)])
    expected = warpqem.simplify(points, torus.faces, ratio=settings.ratio, device=settings.device).points
    stage = Usd.Stage.Open(os.fspath(output))
    attribute = UsdGeom.Mesh(stage.GetPrimAtPath(PRIM)).GetPointsAttr()
    return all(np.array_equal(attribute.Get(float(frame)), expected[frame]) for frame in range(torus.frame_count))


def _measure(folder: Path, face_count: int, frame_count: int, settings: Settings) -> list[Row]:
    source, target = folder / "in.usdc", folder / "out.usdc"
    torus = write_clip(source, face_count, frame_count)
    command = [sys.executable, "-m", "warpqem", "simplify", str(source), "-o", str(target)]
    command += ["--ratio", str(settings.ratio), *(["--device", settings.device] if settings.device else [])]
    rows = []
    for access, value in (("mapped", "0"), ("read", "1")):
        cost = run_process(command, {READ_VARIABLE: value})
        rows.append(
            {
                "faces": len(torus.faces),
                "frames": frame_count,
                "file_mb": source.stat().st_size / 2**20,
                "access": access,
                "ns": 1e9 * cost.cpu_seconds / len(torus.faces) / frame_count,
                "same_bits": {True: "yes", False: "NO", None: None}[_same_bits(torus, target, settings)],
                **asdict(cost),
            }
        )
    source.unlink()
    target.unlink()
    return rows


def run(settings: Settings) -> Report:
    """`warpqem simplify` on point caches: short, long, and of a large mesh."""
    report = Report("stream", "Frames as a stream", describe_machine(["warpqem", "usd-core"]))
    rows: list[Row] = []
    with tempfile.TemporaryDirectory(prefix="warpqem-bench-") as folder:
        write_clip(Path(folder) / "warm.usdc", 1000, 8)
        warm = [sys.executable, "-m", "warpqem", "simplify", str(Path(folder) / "warm.usdc"), "--ratio", "0.5"]
        device = ["--device", settings.device] if settings.device else []
        # Compiles the kernels where that has not been done.
        run_process([*warm, "-o", str(Path(folder) / "warm_out.usdc"), *device], {})
        for face_count, frame_count in QUICK_CLIPS if settings.quick else CLIPS:
            rows += _measure(Path(folder), face_count, frame_count, settings)
    report.tables.append(Table("Point caches, the whole command", COLUMNS, rows))
    report.notes.append(f"'read': with {READ_VARIABLE}=1, so that pages of the files do not count as the process's.")
    return report
