"""Simplify the meshes of a stage to a number of faces for all of them together.

Every mesh is ordered once, as far as it may go, to learn what its collapses cost; the budget is split by that
(`warpqem.usd.commands.budget`), and each mesh is placed at its part of the same ordering.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from pxr import Usd, UsdGeom

from warpqem.errors import VaryingTopologyError
from warpqem.frames.stream import held_bytes
from warpqem.runtime.memory import parse_bytes
from warpqem.usd.commands.budget import CostCurve, split_budget
from warpqem.usd.commands.context import Progress, SharedOrder
from warpqem.usd.commands.option_checks import face_budget
from warpqem.usd.commands.varying import run_alone
from warpqem.usd.read.topology_runs import TopologyRun, choose_runs, open_run

if TYPE_CHECKING:
    from warpqem.usd.commands.run import Run

__all__ = ["simplify_to_budget"]

# Faces that a trial goes down to, or as near as it can: the two of a sheet, which another collapse would halve. Closed
# surfaces keep at least the 4 of a tetrahedron.
TRIAL_FACES = 2
# Orderings of so many bytes together are kept from the trials for the results; other meshes are ordered again, with the
# same bits. Enough for some thousands of small meshes, for which a second ordering would take most of the time.
KEPT_BYTES = 512 * 2**20
# Where memory is limited they take one part in so many of it at most.
KEPT_PART = 4
# Share of the work that the trials are, when orderings are kept.
TRIAL_SHARE = 0.7


@dataclass(frozen=True)
class _Trial:
    """What simplifying one mesh costs: a curve, or one for each run of constant topology."""

    prim: Usd.Prim
    curves: list[CostCurve]
    varies: bool = False
    shared: SharedOrder | None = None


def simplify_to_budget(run: Run, prims: Sequence[Usd.Prim], faces: int | str) -> None:
    """Simplify meshes to so many faces together, or such a share of theirs.

    Of a mesh whose topology varies over time the mean over its frames counts.

    Args:
        run: The pass over the stage.
        prims: The meshes.
        faces: A number, or a share such as "25%" of the faces that the input has of those meshes that can be read.
    """
    trials, kept = [], 0
    most = KEPT_BYTES if run.options.memory is None else min(KEPT_BYTES, parse_bytes(run.options.memory) // KEPT_PART)
    for index, prim in enumerate(prims):
        part = run.part(TRIAL_SHARE * index / len(prims), TRIAL_SHARE / len(prims), prim)
        trial = run.guarded(_try_prim, prim, run, part, most - kept)
        if trial is not None:
            trials.append(trial)
            kept += _bytes_of(trial.shared)
    curves = [curve for trial in trials for curve in trial.curves]
    total = round(sum(curve.counted_faces for curve in curves))
    budget = face_budget(faces, total)
    split = split_budget(curves, budget)
    counts = iter(split)
    short = sum(curve.weight * count for curve, count in zip(curves, split, strict=True)) > budget
    # A trial that has been placed is released.
    trials.reverse()
    for index in range(len(trials)):
        trial = trials.pop()
        # The last collapse of a curve may take one face more than was gone down to.
        targets = [max(next(counts), TRIAL_FACES) for _ in trial.curves]
        start, share = TRIAL_SHARE + (1 - TRIAL_SHARE) * index / len(prims), (1 - TRIAL_SHARE) / len(prims)
        path, part = str(trial.prim.GetPath()), run.part(start, share, trial.prim)
        run.guarded(run.simplify_to, trial.prim, part, targets, trial.varies, trial.shared)
        report = run.reports[path]
        if short and report.status == "kept" and report.stopped is None and run.options.size_limit is not None:
            # It has as many faces as its curve leaves it, and the budget asks for fewer.
            report.stopped, report.message = "max_size_error", run.kept_whole


def _try_prim(prim: Usd.Prim, run: Run, progress: Progress, room: int) -> _Trial:
    """How the error of a mesh grows on the way to as few faces as it may have."""
    try:
        shared = SharedOrder(min_faces=TRIAL_FACES)
        curve = _curve(run, prim, progress, shared)
    except VaryingTopologyError:
        if run.refuses_runs(prim):
            raise
        return _Trial(prim, _run_curves(run, prim, progress), varies=True)
    return _Trial(prim, [curve], shared=shared if 0 < _bytes_of(shared) <= room else None)


def _run_curves(run: Run, prim: Usd.Prim, progress: Progress) -> list[CostCurve]:
    runs = choose_runs(UsdGeom.Mesh(prim), run.options.frames)
    frame_count = sum(len(part.times) for part in runs)
    return [_run_curve(run, prim, part, len(part.times) / frame_count, progress) for part in runs]


def _run_curve(run: Run, prim: Usd.Prim, part: TopologyRun, weight: float, progress: Progress) -> CostCurve:
    if part.is_empty:
        return CostCurve(0, np.zeros(0), np.zeros(0, dtype=np.int64), weight)
    with ExitStack() as cleanup:
        shown = cleanup.enter_context(open_run(prim, part, run.context.folder))
        alone = run_alone(run, shown, part, cleanup, quiet=True)
        return _curve(alone, shown, progress, SharedOrder(min_faces=TRIAL_FACES), weight)


def _curve(run: Run, prim: Usd.Prim, progress: Progress, shared: SharedOrder, weight: float = 1.0) -> CostCurve:
    """The curve of a mesh; its ordering is in ``shared`` afterwards, where it can be used again."""
    job, costs = run.try_out(prim, progress, shared, TRIAL_FACES)
    if costs is None:
        return CostCurve(len(job.mesh.faces), np.zeros(0), np.zeros(0, dtype=np.int64), weight)
    face_count, removed = len(job.mesh.faces), costs.log.faces_removed
    if job.repair is not None:
        # Repeats go for nothing, and the backs of faces with them.
        base = len(job.repair.face_index)
        face_count = job.repair.count_with_backs(np.arange(base))
        removed = np.diff(np.cumsum(removed, dtype=np.int64) * face_count // base, prepend=0)
    return CostCurve.from_log(
        face_count=face_count,
        cost=costs.log.cost,
        faces_removed=removed,
        unit_length=costs.diagonal * job.mesh.world_scale,
        frame_count=len(costs.key_frames),
        weight=weight,
        input_faces=len(job.mesh.faces),
    )


def _bytes_of(shared: SharedOrder | None) -> int:
    if shared is None or shared.order is None or shared.job is None:
        return 0
    return shared.order.held_bytes + held_bytes(shared.job.frames)
