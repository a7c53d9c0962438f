"""``samples``: how far the errors of small meshes are from those at very many samples, by the number of samples."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import warpqem
from benchmarks.machine import describe_machine
from benchmarks.props import Prop, props
from benchmarks.report import Column, Report, Table
from benchmarks.settings import Settings
from warpqem.errors import UnreachableTargetError
from warpqem.frames.stream import ArrayFrames
from warpqem.measure.measured import Measured, measure_frames, measured_errors
from warpqem.runtime.device import resolve_device

__all__ = ["run"]

# Props, and what is left of their faces.
COUNT, QUICK_COUNT, RATIOS = 60, 2, (0.25, 0.6)
# Samples that are compared with so many; None for those that are taken where none are asked for.
SAMPLES, DENSE = (500, 1000, 2000, 4000, 20000, None), 200_000
# Runs of each, with seeds of their own.
SEEDS = 3
FIGURES = ("rms", "mean", "normal_deviation")
# A smaller distance than this, in %, is none.
NO_ERROR = 1e-6

COLUMNS = (
    Column("samples", "samples"),
    *(
        Column(f"{name}_{part}", f"{name} off by, {part}, %", ".2f")
        for name in FIGURES
        for part in ("median", "95 of 100", "99 of 100", "most")
    ),
)


@dataclass(frozen=True)
class _Pair:
    """A mesh and what it is simplified to."""

    points: NDArray[Any]
    faces: NDArray[Any]
    result: warpqem.SimplifiedMesh

    def errors(self, samples: int | None, seed: int, device: str) -> Measured:
        """Errors at so many samples."""
        reference, test = ArrayFrames(self.points[None]), ArrayFrames(self.result.points)
        found = measure_frames(
            reference, self.faces, test, self.result.faces, [0], samples=samples, seed=seed, device=device, overall=True
        )
        return measured_errors(found)


def _pairs(count: int, device: str) -> Iterator[_Pair]:
    for prop in props(count, seed=7):
        for ratio in RATIOS:
            yield _Pair(prop.points, prop.faces, _simplified(prop, ratio, device))


def _simplified(prop: Prop, ratio: float, device: str) -> warpqem.SimplifiedMesh:
    """A prop at a part of its faces, or as near to that as it goes."""
    try:
        return warpqem.simplify(prop.points, prop.faces, ratio=ratio, device=device)
    except UnreachableTargetError as error:
        if error.result is None:
            raise
        return error.result


def run(settings: Settings) -> Report:
    """Small meshes, simplified, measured at few samples and at very many."""
    report = Report("samples", "Errors by the number of samples", describe_machine(["warpqem"]))
    device = resolve_device(settings.device)
    off: dict[int | None, list[list[float]]] = {samples: [] for samples in SAMPLES}
    for pair in _pairs(QUICK_COUNT if settings.quick else COUNT, device):
        dense = pair.errors(DENSE, SEEDS, device)
        if dense.rms < NO_ERROR:
            continue
        for samples in SAMPLES:
            for seed in range(SEEDS):
                found = pair.errors(samples, seed, device)
                off[samples].append([getattr(found, name) / getattr(dense, name) - 1 for name in FIGURES])
    rows = []
    for samples, values in off.items():
        row: dict[str, Any] = {"samples": "as many as suit" if samples is None else str(samples)}
        for name, error in zip(FIGURES, 100 * np.abs(np.array(values)).T, strict=True):
            row[f"{name}_median"] = float(np.median(error))
            row[f"{name}_95 of 100"], row[f"{name}_99 of 100"] = map(float, np.quantile(error, [0.95, 0.99]))
            row[f"{name}_most"] = float(error.max())
        rows.append(row)
    report.tables.append(Table(f"Against {DENSE} samples, {len(off[None])} runs each", COLUMNS, rows))
    return report
