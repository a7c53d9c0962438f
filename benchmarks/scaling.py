"""``scaling``: time and memory of warpqem over the number of faces and of frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from benchmarks.contenders import BASE
from benchmarks.duel import outcome_row
from benchmarks.figures import log_slope
from benchmarks.machine import available_memory, describe_machine
from benchmarks.report import Column, Report, Row, Table
from benchmarks.settings import Settings
from benchmarks.turns import run_in_turn
from benchmarks.work import torus_work

__all__ = ["predicted_bytes", "run"]

FACE_COUNTS = (5_000, 10_000, 20_000, 50_000, 100_000, 200_000, 500_000, 1_000_000)
FACE_COUNT_FRAMES = 48
FRAME_COUNTS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
FRAME_COUNT_FACES = 16_000
QUICK_FACE_COUNTS, QUICK_FRAME_COUNTS, QUICK_FRAMES, QUICK_FACES = (2_000, 4_000, 8_000), (1, 4, 16), 4, 2_000

# Upper estimates of host and device memory, so that a size is skipped before it brings the machine down: per face the
# topology's arrays on host and device; per vertex and key frame position, quadric and what a pass keeps (40 + 4 x 12);
# per vertex and frame the input, its copies for the child process, the block on the device and the quality's float64.
FACE_BYTES = 600
KEY_FRAME_BYTES = 88
FRAME_BYTES = 100
KEY_FRAMES = 16
# Part of the free memory that a run may be predicted to need.
MEMORY_SHARE = 0.8

COLUMNS = (
    Column("work", "mesh"),
    Column("faces_before", "faces", "d"),
    Column("frames", "frames", "d"),
    Column("seconds", "s", ".3f"),
    Column("cpu_seconds", "CPU s", ".3f"),
    Column("ns", "ns / face / frame", ".0f"),
    Column("local_slope", "slope from the last", ".2f"),
    Column("peak_mb", "host MB", ".0f"),
    Column("rms", "RMS %", ".4f"),
    Column("hausdorff", "Hausdorff %", ".3f"),
    Column("slide", "slide %", ".3f"),
)


def predicted_bytes(face_count: int, frame_count: int) -> int:
    """Memory that simplifying a closed mesh may need, an upper estimate: half as many vertices as faces."""
    vertices = face_count // 2
    key_frames = min(frame_count, KEY_FRAMES)
    return FACE_BYTES * face_count + vertices * (KEY_FRAME_BYTES * key_frames + FRAME_BYTES * frame_count)


def _measure(face_count: int, frame_count: int, settings: Settings) -> Row:
    work = torus_work(face_count, frame_count, settings.ratio)
    outcome = run_in_turn(work, [BASE], settings.turns, settings.device)[BASE]
    row = {"work": work.name, "faces_before": len(work.faces), "frames": len(work.points)}
    return row | dict(outcome_row(BASE, work, outcome, None, settings.device))


def _sweep(
    report: Report, title: str, sizes: Sequence[tuple[int, int]], work_of: Callable[[Row], int], settings: Settings
) -> None:
    """Measure the sizes (faces, frames) that fit; add their table and slopes."""
    rows: list[dict] = []
    for faces, frames in sizes:
        needed, free = predicted_bytes(faces, frames), available_memory(settings.device)
        if needed > MEMORY_SHARE * free:
            report.notes.append(
                f"{faces} faces x {frames} frames skipped: may need {needed / 1e9:.1f} GB, {free / 1e9:.1f} GB are free"
            )
            continue
        row = dict(_measure(faces, frames, settings))
        if row["failure"]:
            report.notes.append(f"{row['work']} failed: {row['failure']}")
            continue
        if rows:
            pair = (rows[-1], row)
            row["local_slope"] = log_slope([work_of(r) for r in pair], [r["seconds"] for r in pair])
        rows.append(row)
    report.tables.append(Table(title, COLUMNS, rows))
    # Small meshes pay for launches, not for work: the upper half says how it goes on.
    for name, part in (("all sizes", rows), ("the upper half", rows[len(rows) // 2 :])):
        slope = log_slope([work_of(r) for r in part], [r["seconds"] for r in part])
        if slope is not None:
            report.notes.append(f"{title}, {name}: time grows with the power {slope:.2f}")


def run(settings: Settings) -> Report:
    """Faces at a fixed number of frames, then frames at a fixed number of faces."""
    report = Report("scaling", "Scaling of warpqem", describe_machine(["warpqem"]))
    quick = settings.quick
    frames = QUICK_FRAMES if quick else FACE_COUNT_FRAMES
    faces = QUICK_FACES if quick else FRAME_COUNT_FACES
    by_faces = [(n, frames) for n in (QUICK_FACE_COUNTS if quick else FACE_COUNTS)]
    by_frames = [(faces, n) for n in (QUICK_FRAME_COUNTS if quick else FRAME_COUNTS)]
    _sweep(report, f"Faces at {frames} frames", by_faces, lambda row: row["faces_before"], settings)
    _sweep(report, f"Frames at {faces} faces", by_frames, lambda row: row["frames"], settings)
    return report
