"""Simplify the meshes of a USD file."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from pxr import Sdf, Usd

from warpqem.arguments.progress import CancelToken, ProgressInput, listener, with_progress_bar
from warpqem.errors import OptionError, StageError
from warpqem.files.outputs import InputFile, OutputFile
from warpqem.usd.checks.input_files import check_stage_outputs
from warpqem.usd.checks.usd_errors import usd_errors_named
from warpqem.usd.commands.context import Announce, Context, SharedOrder
from warpqem.usd.commands.lods import FileLevels, LevelLayer, LevelReport, VariantLevels
from warpqem.usd.commands.output_names import output_files
from warpqem.usd.commands.rig_options import level_options
from warpqem.usd.commands.run import Run
from warpqem.usd.commands.run_info import run_info
from warpqem.usd.commands.simplify_options import SimplifyOptions
from warpqem.usd.commands.usd_lod import UsdLodLevels
from warpqem.usd.read.open_stage import find_meshes, open_input, open_stage
from warpqem.usd.read.variants import lost_variants
from warpqem.usd.write.layer_files import check_output_path
from warpqem.usd.write.layer_output import check_output_layer
from warpqem.usd.write.package import is_package
from warpqem.usd.write.stage_report import PrimReport, StageReport

__all__ = ["simplify_stage"]

Save = Callable[[Any], list[str]]

_log = logging.getLogger(__name__)


@with_progress_bar
def simplify_stage(
    input_path: str | os.PathLike[str] | Usd.Stage,
    output_path: str | os.PathLike[str] | Sdf.Layer,
    options: SimplifyOptions,
    progress: ProgressInput = None,
    announce: Announce | None = None,
    other_outputs: Sequence[OutputFile] = (),
    cancel: CancelToken | None = None,
) -> StageReport:
    """Simplify every mesh of a USD file over all its frames and write the result.

    The input is never touched. The output is a layer over the input that holds only the new meshes, one that offers
    them as levels of detail beside the input's own, or a self-contained file. Skinned and blend-shaped meshes keep
    their skin, unless `options.bake`. Primvars, normals and subsets are brought to the new topology; what cannot be is
    dropped and named in the report. A mesh that fails is left as it is, and one that has no legal collapse left is done
    as far as it goes, unless `options.strict`.

    Args:
        input_path: .usd, .usda, .usdc or .usdz file, or whatever the resolver of USD finds, such as a file on its
            search path, one in a package, or the identifier of a layer in memory. Or an open stage, which is taken as
            it is: with unsaved edits, session layer, load rules, population mask and resolver context.
        output_path: .usd, .usda, .usdc or .usdz file; replaced if it exists. A package holds one flat layer and all
            files that it names; with `options.lods` the layers of the input. Or a layer, which gets the edits beside
            what it holds and is not saved: one of the stage's own layers, where they show at once, or another one, that
            is to be a sublayer above them. Nothing else of an open stage changes, such as its edit target.
        options: What to do.
        progress: Called with the fraction done and what is being done; True for a bar.
        announce: Called with the name of each mesh and the memory plan for it, before the work on it.
        other_outputs: What else the caller is going to write. Neither the output nor one of these may be a file that is
            read, such as a layer or a texture of the input, or the same file as another of them.
        cancel: Ends the call from another thread, such as a `threading.Event`, where `progress` would be called; then
            nothing is written.

    Returns:
        A report on every mesh, level after level where `options.lods` is given. Nothing is written if all meshes fail.

    Raises:
        StageError: the input cannot be read, has no mesh, or the output cannot be written; with `strict`, also a mesh
            that cannot be done.
            A stronger layer of the stage would hide an edit in the layer given as output.
        OptionError: an option or an output path is wrong, or the root prims of the input cannot hold levels. A file
            cannot be a layer over a stage in memory, so that `options.flatten` is needed there.
        DeviceError: there is no such device.
        CancelledError: `cancel` was set.

    Examples:
        With the shipped scenes beside you:

        >>> from warpqem.usd import SimplifyOptions, simplify_stage
        >>> report = simplify_stage("cape_wind.usdc", "cape_20.usdc", SimplifyOptions(ratio=0.2))
        >>> [prim.status for prim in report.prims]
        ['simplified']
    """
    listen = listener(progress, cancel)
    output = _checked_output(input_path, output_path, options)
    written: list[OutputFile] = []
    if not isinstance(output_path, Sdf.Layer):
        written = [OutputFile("output", path) for path in output_files(output_path, options)]
    start = time.perf_counter()
    name = input_path.GetRootLayer().identifier if isinstance(input_path, Usd.Stage) else os.fspath(input_path)
    if isinstance(input_path, Usd.Stage):
        _log.info("%s: reading", name)
    stage, problems = open_input(input_path, options.asset_roots)
    if isinstance(output, Sdf.Layer):
        check_output_layer(output, stage)
    elif not (options.flatten or is_package(output)):
        problems += _check_files(stage)
    read = [stage] if options.poses is None else [stage, open_stage(options.poses)]
    points = [] if options.face_points is None else [InputFile(options.face_points, "the file of points")]
    check_stage_outputs([*written, *other_outputs], read, points)
    # What fails while a layer is being written is no matter of one mesh: half of it would be there.
    with usd_errors_named(name), ExitStack() as cleanup:
        selection = find_meshes(stage, options.prims, by_root=bool(options.lods) and not options.lod_files)
        if not selection.paths():
            raise StageError("there is no mesh on the stage")
        flat = isinstance(output, Path) and _is_flat(output, options)
        context = Context(
            stage,
            selection,
            # A package of one flat layer is one as any other.
            replace(options, flatten=flat),
            output.parent if isinstance(output, Path) else None,
            listen or (lambda fraction, text: None),
            announce,
            cleanup,
        )
        report, save = (_simplify_levels if options.lods else _simplify_once)(context, [*written, *other_outputs])
        report.input = name
        if len(report.failed) < len(report.prims):
            problems += save(output)
            if isinstance(output_path, Sdf.Layer):
                report.outputs = [output_path.identifier]
            else:
                report.outputs = [os.fspath(file.path) for file in written]
            report.output = report.outputs[0]
            _log.info("%s: written", report.output)
            if flat:
                report.notes += lost_variants(stage)
    report.problems = problems
    report.run = run_info(options, time.perf_counter() - start)
    return report


def _checked_output(
    input_path: str | os.PathLike[str] | Usd.Stage,
    output_path: str | os.PathLike[str] | Sdf.Layer,
    options: SimplifyOptions,
) -> Path | Sdf.Layer:
    if not isinstance(output_path, Sdf.Layer):
        read = [] if isinstance(input_path, Usd.Stage) else [input_path]
        return check_output_path(output_path, read, packages=True)
    for name in ("flatten", "lods", "bake_normals"):
        if getattr(options, name):
            raise OptionError(f"{name}: needs a file as output, not the layer {output_path.identifier}")
    return output_path


def _is_flat(output: Path, options: SimplifyOptions) -> bool:
    """Whether one flat layer is written, or one for each level; levels in a package are layers over the input."""
    return options.flatten or (is_package(output) and (not options.lods or options.lod_files))


def _check_files(stage: Usd.Stage) -> list[str]:
    """What a file over the root layer of a stage will not show of it.

    Raises:
        OptionError: the root layer is in memory.
    """
    root, session = stage.GetRootLayer(), stage.GetSessionLayer()
    if root.anonymous:
        raise OptionError(
            f"the root layer {root.identifier} is in memory, and a file cannot be a layer over it; "
            "`flatten`, or give a layer as output"
        )
    lacking = [
        f"{layer.identifier}: has changes that are not saved"
        for layer in stage.GetUsedLayers()
        if layer.dirty and not layer.anonymous
    ]
    if session.subLayerPaths:
        lacking.append("the session layer of the stage holds opinions")
    return [
        f"{text}; the output is a layer over the files and does not show this, unless it is flattened"
        for text in lacking
    ]


def _simplify_once(context: Context, written: Sequence[OutputFile]) -> tuple[StageReport, Save]:
    run = Run(context)
    run.simplify()
    return run.report(), lambda output: run.layer.save(output, context.options.flatten, written)


def _simplify_levels(context: Context, written: Sequence[OutputFile]) -> tuple[StageReport, Save]:
    """Every mesh is read and its edges are collapsed once; each level then equals what its ratio alone would give."""
    options = context.options
    levels: LevelLayer | FileLevels
    if options.lod_files:
        levels = FileLevels(options.flatten)
    else:
        levels = (UsdLodLevels if options.usd_lod else VariantLevels)(context.stage, context.selection)
    alone: dict[str, Any] = {"lods": (), "usd_lod": False, "lod_files": False}
    by_root = not options.lod_files
    each = [replace(level_options(options, level), **alone, ratio=ratio) for level, ratio in enumerate(options.lods)]
    runs = [Run(replace(context, options=one), by_root) for one in each]
    selections = [run.select() for run in runs]
    for prim_index, prim in enumerate(selections[0]):
        shared = SharedOrder(options.lods[-1])
        for index, run in enumerate(runs):
            done = (prim_index + index / len(runs)) / len(selections[0])
            part = run.part(done, 1 / len(runs) / len(selections[0]), prim, f"LOD{index + 1} ")
            run.simplify_one(prim, part, shared)
    context.progress(1.0, "done")
    reports: list[PrimReport] = []
    for run in runs:
        run.finish()
        report = run.report()
        name = levels.add(run.layer, report.face_share)
        reports += [LevelReport(**vars(prim), level=name) for prim in report.prims]
    notes = list(dict.fromkeys(note for run in runs for note in run.notes))
    return StageReport("", None, reports, notes=notes), lambda output: levels.save(output, written)
