"""What the command works on: packed meshes, the shipped scenes, or a generated mesh where there is neither."""

from __future__ import annotations

import importlib.util
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.machine import ROOT, describe_host
from benchmarks.report import Column, Report, Table
from benchmarks.settings import Settings
from benchmarks.work import Work, load_work, save_work, torus_work, usd_work

__all__ = ["QUALITIES", "cpu_figures", "figures_of", "main_work", "pack", "packed_figures", "small_work", "works"]

SCENES = ("quadruped_gallop", "cape_wind", "talking_head")
# Beside the meshes: what a CPU makes of them.
FIGURES = "cpu.json"
QUALITIES = ("fast", "best")
# As many faces and frames as the horse of the README.
TORUS, QUICK_TORUS = (16_000, 48), (600, 6)
# Points that distances are measured at, and frames.
SAMPLES, FRAMES = 20_000, 8


def works(settings: Settings) -> list[Work]:
    """The meshes that were given, in a file or a folder of them; else the shipped scenes, or a torus without USD.

    Raises:
        FileNotFoundError: there is no .npz file.
        ValueError: one holds no points or no faces.
    """
    if settings.data is not None:
        files = sorted(settings.data.glob("*.npz")) if settings.data.is_dir() else [settings.data]
        if not files or not files[0].exists():
            raise FileNotFoundError(f"{settings.data}: no .npz file with points (F, V, 3) and faces (N, 3)")
        return [_load(file, settings.ratio) for file in files]
    if settings.quick or importlib.util.find_spec("pxr") is None:
        return [small_work(settings)]
    return [usd_work(ROOT / "scenes" / f"{name}.usdc", settings.ratio) for name in SCENES]


def _load(file: Path, ratio: float) -> Work:
    """A mesh that :func:`pack` has put there, or one of your own: its name and target may be missing."""
    with np.load(file) as stored:
        names = set(stored.files)
        if not {"points", "faces"} <= names:
            raise ValueError(
                f"{file}: expected the arrays points and faces, found {', '.join(sorted(names)) or 'none'}"
            )
        if {"name", "target_faces"} <= names:
            return load_work(file)
        points = np.ascontiguousarray(stored["points"], dtype=np.float32)
        faces = np.ascontiguousarray(stored["faces"], dtype=np.int32)
    return Work(file.stem, points, faces, max(1, round(ratio * len(faces))))


def main_work(settings: Settings) -> Work:
    """The galloping quadruped where it is there, else the first mesh."""
    found = works(settings)
    return next((work for work in found if "quadruped" in work.name), found[0])


def small_work(settings: Settings) -> Work:
    """A generated mesh that needs no file."""
    return torus_work(*(QUICK_TORUS if settings.quick else TORUS), settings.ratio)


def figures_of(work: Work, quality: str, device: str) -> dict[str, Any]:
    """Faces, RMS distance in % of the diagonal and seconds of a mesh simplified on a device."""
    import warpqem
    from warpqem.measure import compare

    start = time.perf_counter()
    result = warpqem.simplify(work.points, work.faces, target_faces=work.target_faces, quality=quality, device=device)
    seconds = time.perf_counter() - start
    measured = compare(
        work.points, work.faces, result.points, result.faces, samples=SAMPLES, frames=FRAMES, device=device
    )
    return {"faces": len(result.faces), "rms": float(measured.rms), "seconds": seconds}


def packed_figures(settings: Settings) -> dict[str, dict[str, Any]]:
    """What a CPU made of the packed meshes, by mesh and quality; empty where nothing says so."""
    folder = settings.data
    file = None if folder is None else (folder if folder.is_dir() else folder.parent) / FIGURES
    return {} if file is None or not file.exists() else json.loads(file.read_text(encoding="utf-8"))["figures"]


def cpu_figures(work: Work, quality: str, packed: dict[str, dict[str, Any]]) -> tuple[dict[str, Any], str] | None:
    """What a CPU makes of a mesh, and where it did; None where nothing is packed and Warp has no CPU compiler."""
    import warp as wp

    if quality in packed.get(work.name, {}):
        return packed[work.name][quality], "packed"
    return (figures_of(work, quality, "cpu"), "here") if wp.is_cpu_available() else None


def pack(settings: Settings) -> Report:
    """Put the meshes and what this CPU makes of them into a folder; ``--usd`` adds a mesh of a file."""
    folder = settings.pack
    assert folder is not None
    folder.mkdir(parents=True, exist_ok=True)
    given = [*works(settings), small_work(settings)]
    if settings.usd is not None:
        given.append(usd_work(settings.usd, settings.ratio, settings.prim))
    given = list({work.name: work for work in given}.values())
    figures: dict[str, dict[str, Any]] = {}
    rows = []
    for work in given:
        file = folder / f"{''.join(c if c.isalnum() else '_' for c in work.name)}.npz"
        save_work(work, file)
        figures[work.name] = {quality: figures_of(work, quality, "cpu") for quality in QUALITIES}
        row = {"mesh": work.name, "size": work.size, "megabytes": file.stat().st_size / 1e6}
        rows.append(row | {quality: figures[work.name][quality]["rms"] for quality in QUALITIES})
        print(f"{file}: {work.size}", flush=True)
    machine = describe_host(["warpqem"])
    text = json.dumps({"commit": machine["commit"], "numpy": np.__version__, "figures": figures}, indent=1)
    (folder / FIGURES).write_text(text + "\n", encoding="utf-8")
    columns = (
        Column("mesh", "mesh"),
        Column("size", "size"),
        Column("megabytes", "MB", ".1f"),
        Column("fast", "RMS %", ".4f"),
        Column("best", "RMS %, best", ".4f"),
    )
    return Report("packed", "Packed for a GPU machine", machine, [Table(str(folder), columns, rows)])
