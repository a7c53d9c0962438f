"""Simplify the meshes of a USD file."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from warpqem.outputs import InputFile, OutputFile
from warpqem.sharing import FrameShare
from warpqem.usd.context import Announce, Context, Progress, SharedOrder
from warpqem.usd.input_files import check_stage_outputs
from warpqem.usd.lods import FileLevels, LevelLayer, LevelReport, VariantLevels
from warpqem.usd.output_names import output_files
from warpqem.usd.report import PrimReport, StageReport
from warpqem.usd.run import Run
from warpqem.usd.run_info import run_info
from warpqem.usd.simplify_options import SimplifyOptions
from warpqem.usd.stage import open_stage, open_with_problems
from warpqem.usd.usd_errors import usd_errors_named
from warpqem.usd.usd_lod import UsdLodLevels
from warpqem.usd.write import check_output_path

__all__ = ["simplify_stage"]

Save = Callable[[Path], list[str]]

_log = logging.getLogger(__name__)


def simplify_stage(
    input_path: str | os.PathLike[str],
    output_path: str | os.PathLike[str],
    options: SimplifyOptions,
    progress: Progress | None = None,
    announce: Announce | None = None,
    share: FrameShare | None = None,
    other_outputs: Sequence[OutputFile] = (),
) -> StageReport:
    """Simplify every mesh of a USD file over all its frames and write the result.

    The input is never touched. The output is a layer over the input that holds only the new meshes, one that offers
    them as levels of detail beside the input's own, or a self-contained file. Skinned and blend-shaped meshes keep
    their skin, unless `options.bake`. Primvars, normals and subsets are brought to the new topology; what cannot be is
    dropped and named in the report. A mesh that fails is left as it is, and one that has no legal collapse left is done
    as far as it goes, unless `options.strict`.

    Args:
        input_path: .usd, .usda, .usdc or .usdz file.
        output_path: .usd, .usda, .usdc or .usdz file; replaced if it exists. A package holds one flat layer and all
            files that it names; with `options.lods` the layers of the input.
        options: What to do.
        progress: Called with the fraction done and what is being done.
        announce: Called with the name of each mesh and the memory plan for it, before the work on it.
        share: Lets other processes place some of the frames; see `warpqem.simplify`. Meshes that are to stay symmetric
            or are simplified in their rest shape are done alone.
        other_outputs: What else the caller is going to write. Neither the output nor one of these may be a file that is
            read, such as a layer or a texture of the input, or the same file as another of them.

    Returns:
        A report on every mesh, level after level where `options.lods` is given. Nothing is written if all meshes fail.

    Raises:
        StageError: the input cannot be read, has no mesh, or the output cannot be written; with `strict`, also a mesh
            that cannot be done.
        OptionError: an option or an output path is wrong, or the root prims of the input cannot hold levels.
        DeviceError: there is no such device.
    """
    output = check_output_path(output_path, [input_path], packages=True)
    written = [OutputFile("output", path) for path in output_files(output_path, options)]
    start = time.perf_counter()
    _log.info("%s: reading", input_path)
    stage, problems = open_with_problems(input_path, options.asset_roots)
    read = [stage] if options.poses is None else [stage, open_stage(options.poses)]
    points = [] if options.face_points is None else [InputFile(options.face_points, "the file of points")]
    check_stage_outputs([*written, *other_outputs], read, points)
    # What fails while a layer is being written is no matter of one mesh: half of it would be there.
    with usd_errors_named(input_path), ExitStack() as cleanup:
        context = Context(
            stage,
            options,
            output.parent,
            progress or (lambda fraction, text: None),
            announce or (lambda name, plan: None),
            cleanup,
            share,
        )
        report = _simplify(context, input_path, output, [*written, *other_outputs])
    report.problems = problems + report.problems
    if report.output is not None:
        report.outputs = [os.fspath(file.path) for file in written]
        report.output = report.outputs[0]
    report.run = run_info(options, time.perf_counter() - start)
    return report


def _simplify(
    context: Context, input_path: str | os.PathLike[str], output: Path, written: Sequence[OutputFile]
) -> StageReport:
    report, save = (_simplify_levels if context.options.lods else _simplify_once)(context, written)
    report.input = os.fspath(input_path)
    if len(report.failed) < len(report.prims):
        report.problems = save(output)
        report.output = os.fspath(output)
        _log.info("%s: written", output)
    return report


def _simplify_once(context: Context, written: Sequence[OutputFile]) -> tuple[StageReport, Save]:
    run = Run(context)
    run.simplify()
    return run.report(), lambda output: run.layer.save(output, context.options.flatten, written)


def _simplify_levels(context: Context, written: Sequence[OutputFile]) -> tuple[StageReport, Save]:
    """Every mesh is read and its edges are collapsed once; each level then equals what its ratio alone would give."""
    options = context.options
    levels: LevelLayer | FileLevels
    if options.lod_files:
        levels = FileLevels(options.flatten, written)
    else:
        levels = (UsdLodLevels if options.usd_lod else VariantLevels)(context.stage, options.prims)
    one = replace(options, lods=(), usd_lod=False, lod_files=False, ratio=1.0)
    runs = [Run(replace(context, options=replace(one, ratio=ratio)), levels.path) for ratio in options.lods]
    selections = [run.select() for run in runs]
    for prim_index, prim in enumerate(selections[0]):
        shared = None if options.memoryless else SharedOrder(options.lods[-1])
        for index, run in enumerate(runs):
            done = (prim_index + index / len(runs)) / len(selections[0])
            part = run.part(done, 1 / len(runs) / len(selections[0]), prim, f"LOD{index + 1} ")
            run.simplify_one(prim, part, shared)
    context.progress(1.0, "done")
    reports: list[PrimReport] = []
    for run in runs:
        report = run.report()
        name = levels.add(run.layer, report.face_share)
        reports += [LevelReport(**vars(prim), level=name) for prim in report.prims]
    return StageReport("", None, reports), levels.save
