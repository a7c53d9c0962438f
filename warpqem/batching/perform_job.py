"""Do one job in this process."""

from __future__ import annotations

import logging
import os
import platform
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from warpqem.batching.fingerprint import take_fingerprint
from warpqem.batching.job_result import DONE, FAILED, PARTIAL, BatchResult, named
from warpqem.batching.jobs import BatchJob
from warpqem.errors import StageError, WarpqemError
from warpqem.runtime.device import device_traits, resolve_device
from warpqem.runtime.memory import DEFAULT_SHARE, available_memory
from warpqem.runtime.process_limits import with_limit
from warpqem.runtime.process_memory import peak_memory, reset_peak
from warpqem.usd.checks.input_check import open_layers
from warpqem.usd.commands.simplify import simplify_stage
from warpqem.usd.commands.simplify_options import SimplifyOptions
from warpqem.usd.write.stage_report import StageReport

__all__ = ["perform", "warm_up"]

_log = logging.getLogger(__name__)


def perform(
    job: BatchJob,
    progress: Callable[[float, str], None] | None = None,
    device: str | None = None,
    memory: int | None = None,
    sharing: int = 1,
) -> BatchResult:
    """Simplify an asset. Whatever is raised on the way becomes the result.

    An output of an earlier run stays where it cannot be made anew.

    Args:
        job: What to do.
        progress: Called with the fraction done and what is being done.
        device: Warp device where the options name none.
        memory: Bytes that the work may take, where the options do not say.
        sharing: Processes that share the device's memory, if it has its own.
    """
    start, begun = time.perf_counter(), time.time()
    reset_peak()
    result = BatchResult(job.input, job.output, FAILED, process=f"{platform.node()}:{os.getpid()}")
    try:
        options = _with_defaults(job.options, device, memory, sharing)
        _make_folder(Path(job.output).parent)
        # Held, so that USD reads no layer twice.
        opened = [open_layers(path, options.asset_roots) for path in (job.input, options.poses) if path is not None]
        result.fingerprint = take_fingerprint(job, begun, [file for each in opened for file in each.files])
        _fill(result, simplify_stage(job.input, job.output, options, progress))
        del opened
    except MemoryError as error:
        result.error = type(error).__name__
        text = f"{job.input}: {error}" if isinstance(error, WarpqemError) else f"{job.input}: out of memory"
        result.message = with_limit(text, error)
    except WarpqemError as error:
        result.error, result.message = type(error).__name__, with_limit(named(job.input, error), error)
    except Exception as error:
        # Nothing that is wrong with one asset may stop the others, nor go unnamed.
        _log.error("%s", job.input, exc_info=error)
        result.error, result.message = type(error).__name__, with_limit(named(job.input, error), error)
    result.seconds = time.perf_counter() - start
    result.peak_memory = peak_memory()
    return result


def warm_up(device: str | None = None) -> None:
    """Compile and load the kernels that most jobs need, by a mesh of a few faces."""
    import numpy as np

    import warpqem

    side = 5
    x, y = np.meshgrid(np.arange(side), np.arange(side))
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    faces = np.concatenate([corner[:, None] + [0, 1, side], corner[:, None] + [1, side + 1, side]])
    # One frame and many have kernels of their own.
    for frame_count in (1, 9):
        height = np.sin(x + np.arange(frame_count)[:, None, None])
        points = np.stack([np.broadcast_to(x, height.shape), np.broadcast_to(y, height.shape), height], axis=-1)
        warpqem.simplify(points.reshape(frame_count, -1, 3).astype(np.float32), faces, ratio=0.5, device=device)


def _with_defaults(options: SimplifyOptions, device: str | None, memory: int | None, sharing: int) -> SimplifyOptions:
    device = resolve_device(options.device or device)
    if options.memory is None and memory is not None:
        free = available_memory(device)
        if free is not None and device_traits(device).own_memory:
            free //= sharing
        memory = memory if free is None else max(1, min(memory, int(DEFAULT_SHARE * free)))
        options = replace(options, memory=memory)
    return replace(options, device=device)


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StageError(f"{folder}: the folder cannot be made ({error.strerror})") from error


def _fill(result: BatchResult, report: StageReport) -> None:
    result.report = report.to_dict()
    result.faces = sum(prim.faces_before for prim in report.prims)
    result.faces_after = sum(prim.faces_after for prim in report.prims)
    result.face_frames = sum(prim.faces_before * prim.frames for prim in report.prims)
    if not report.failed:
        result.status = DONE
        return
    result.status = PARTIAL if report.output is not None else FAILED
    result.error = StageError.__name__
    first = report.failed[0].message
    more = len(report.failed) - 1
    result.message = f"{result.input}: {first}" + (f" (and {more} more)" if more else "")
