"""Simplify a mesh whose topology varies over time: each run of constant topology over its own frames."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from pxr import Usd, UsdGeom

from warpqem.errors import CancelledError, DeviceError, OptionError, StageError, WarpqemError
from warpqem.measure import Measured
from warpqem.measure.measured import ERRORS, joined_errors
from warpqem.usd.commands.context import Progress
from warpqem.usd.commands.simplify_options import SimplifyOptions
from warpqem.usd.read.time_codes import FrameRange
from warpqem.usd.read.topology_runs import TopologyRun, choose_runs, describe_runs, open_run
from warpqem.usd.write.stage_report import PrimReport, RunReport
from warpqem.usd.write.topology_run_output import RunOutput

if TYPE_CHECKING:
    from warpqem.usd.commands.run import Run

__all__ = ["run_alone", "simplify_runs"]


def simplify_runs(parent: Run, prim: Usd.Prim, progress: Progress, targets: Sequence[int] | None = None) -> None:
    """Simplify every run of a mesh into the layer of a pass over its stage.

    Args:
        parent: The pass; its report on the mesh is filled in.
        prim: The mesh.
        progress: Called with the part done.
        targets: Faces of each run; None for what the options ask for in each.

    Raises:
        StageError: a run cannot be done; nothing of the mesh is written then.
    """
    report = parent.reports[str(prim.GetPath())]
    mesh = UsdGeom.Mesh(prim)
    runs = choose_runs(mesh, parent.options.frames)
    output = RunOutput(parent.layer, prim, runs)
    found = []
    try:
        for index, run in enumerate(runs):
            part = _part(progress, index, len(runs))
            found.append(_simplify_run(parent, prim, run, output, part, None if targets is None else targets[index]))
        if any(part.status == "simplified" for part in found):
            output.finish()
    except BaseException:
        output.discard()
        raise
    _sum_up(report, runs, found)
    if len(runs) > 1:
        report.notes.append(_note(mesh, runs))
    if parent.options.bake_normals is not None and report.status == "simplified":
        report.problems.append(f"{prim.GetPath()}: no normal map: its topology varies over time")


def run_alone(parent: Run, shown: Usd.Prim, run: TopologyRun, cleanup: ExitStack, quiet: bool = False) -> Run:
    """A pass over the stage that shows one run of a mesh alone, with the options of another pass."""
    options = replace(parent.options, frames=_frames(parent.options, run), prims=(), bake_normals=None)
    announce = None if quiet else parent.context.announce
    context = replace(parent.context, stage=shown.GetStage(), options=options, cleanup=cleanup, announce=announce)
    alone = type(parent)(context)
    path = str(shown.GetPath())
    alone.reports[path] = PrimReport(path, "simplified")
    alone.core.face_points = parent.core.face_points
    return alone


def _frames(options: SimplifyOptions, run: TopologyRun) -> FrameRange | None:
    return None if options.frames is None else FrameRange(run.times[0], run.times[-1], options.frames.step)


def _simplify_run(
    parent: Run, prim: Usd.Prim, run: TopologyRun, output: RunOutput, progress: Progress, target: int | None
) -> PrimReport:
    path = str(prim.GetPath())
    if run.is_empty:
        output.keep()
        return PrimReport(path, "kept", frames=len(run.times), message="the mesh has no faces")
    with ExitStack() as cleanup:
        shown = cleanup.enter_context(open_run(prim, run, parent.context.folder))
        # One plan says how all are done.
        alone = run_alone(parent, shown, run, cleanup, quiet=run.start > float("-inf"))
        try:
            alone.simplify_constant(shown, progress, target)
            alone.measure_waiting()
        except (OptionError, DeviceError, CancelledError):
            raise
        except WarpqemError as error:
            raise StageError(f"{path}, {run}: {str(error).removeprefix(f'{path}: ')}") from error
        report = alone.reports[path]
        if report.status == "simplified":
            output.add(alone.layer)
        else:
            output.keep()
    return report


def _part(progress: Progress, index: int, count: int) -> Progress:
    return lambda fraction, text: progress((index + fraction) / count, text)


def _note(mesh: UsdGeom.Mesh, runs: Sequence[TopologyRun]) -> str:
    how = "each was simplified over its own frames"
    if all(len(run.times) == 1 for run in runs):
        how = "each frame was simplified for itself, so nothing keeps vertices steady from one to the next"
    return f"{mesh.GetPath()}: {describe_runs(mesh, runs)}; {how}"


def _sum_up(report: PrimReport, runs: Sequence[TopologyRun], found: Sequence[PrimReport]) -> None:
    """The report on a mesh from those on its runs: counts of faces and points are means over the frames."""
    frames = [len(run.times) for run in runs]
    report.frames = sum(frames)
    for name in ("faces_before", "faces_after", "vertices_before", "vertices_after"):
        total = sum(getattr(part, name) * count for part, count in zip(found, frames, strict=True))
        setattr(report, name, round(total / report.frames))
    done = [part for part in found if part.status == "simplified"]
    report.status = "simplified" if done else "kept"
    report.message = None if done else found[0].message
    if done:
        report.estimate = max(part.estimate or 0.0 for part in done)
        report.measured = _measured(found)
        report.stopped = ", ".join(dict.fromkeys(part.stopped for part in done if part.stopped))
        report.skin, report.symmetry, report.plan = done[0].skin, done[0].symmetry, done[0].plan
    report.components_removed = sum(part.components_removed for part in done)
    report.dropped = list(dict.fromkeys(text for part in found for text in part.dropped))
    report.problems = list(dict.fromkeys(text for part in found for text in part.problems))
    report.notes = list(dict.fromkeys(text for part in found for text in part.notes))
    if len(runs) > 1:
        report.runs = [
            RunReport(
                run.times[0],
                run.times[-1],
                count,
                part.faces_before,
                part.faces_after,
                part.measured,
                part.estimate,
                part.stopped,
            )
            for run, count, part in zip(runs, frames, found, strict=True)
        ]


def _measured(found: Sequence[PrimReport]) -> dict[str, Any] | None:
    """The errors over all runs; a run that is kept has none. None where a run was not measured."""
    parts = []
    for part in found:
        if part.status == "kept":
            counts = {"frame_count": part.frames, "test_faces": part.faces_after, "collapsed_frames": ()}
            parts.append(Measured(**{**dict.fromkeys(ERRORS, 0), **counts}))  # type: ignore[arg-type]  # fields by name
        elif part.measured is None:
            return None
        else:
            parts.append(Measured(**{name: part.measured[name] for name in ERRORS}))
    return joined_errors(parts).to_dict()
