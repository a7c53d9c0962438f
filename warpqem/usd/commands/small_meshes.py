"""Small meshes in one frame, of which a stage may have thousands: read, simplified, written and measured in groups.

Each step of all of a group comes before the next step. USD takes a fifth of the time for calls that follow each other,
and many meshes are measured together in little more than the time of one. What is done for a mesh, and what comes of
it, is the same as alone; but where the first error ends a run, it may be that of a later mesh, which could not be read.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from pxr import Usd

from warpqem.errors import VaryingTopologyError
from warpqem.measure.surfaces import SMALL_FACES
from warpqem.runtime.memory import parse_bytes
from warpqem.usd.commands.context import CORE_SHARE, Progress
from warpqem.usd.commands.measuring import MAX_TOGETHER
from warpqem.usd.commands.mesh_job import MeshJob
from warpqem.usd.commands.mesh_result import MeshResult

if TYPE_CHECKING:
    from warpqem.usd.commands.run import Run

__all__ = ["simplify_in_groups"]

# What a mesh of a group takes until it is measured, and how large a part of a limited memory a group may take.
MESH_BYTES, GROUP_PART = 500_000, 8


def simplify_in_groups(run: Run, prims: Sequence[Usd.Prim]) -> None:
    """Simplify meshes into the layer of a pass; those that are not small each for itself, between groups.

    Args:
        run: The pass over the stage.
        prims: The meshes.
    """
    group: list[MeshJob] = []
    first, count, most = 0, max(1, len(prims)), _most_together(run.options.memory)
    for index, prim in enumerate(prims):
        read = run.guarded(_read, prim, run)
        if isinstance(read, MeshJob) and _is_small(read):
            group.append(read)
        elif read is not None:
            _simplify_group(run, group, first / count, (index - first) / count)
            job = read if isinstance(read, MeshJob) else None
            run.simplify_one(prim, run.part(index / count, 1 / count, prim), job=job)
            group, first = [], index + 1
        if len(group) == most:
            _simplify_group(run, group, first / count, (index + 1 - first) / count)
            group, first = [], index + 1
    _simplify_group(run, group, first / count, (count - first) / count)


def _most_together(memory: int | str | None) -> int:
    """Meshes of a group at most, where memory is limited to so much."""
    if memory is None:
        return MAX_TOGETHER
    return max(1, min(MAX_TOGETHER, parse_bytes(memory) // (GROUP_PART * MESH_BYTES)))


def _is_small(job: MeshJob) -> bool:
    return len(job.mesh.faces) <= SMALL_FACES and job.skin is None and job.frames.frame_count == 1


def _simplify_group(run: Run, group: Sequence[MeshJob], start: float, share: float) -> None:
    """Simplify meshes that have been read; their progress begins at ``start`` and is so much of the whole."""
    size = max(1, len(group))
    core, rest = share * CORE_SHARE / size, share * (1.0 - CORE_SHARE) / size
    results = []
    for job in group:
        prim = job.source.prim
        results.append(run.guarded(_simplify, prim, run, job, run.part(start, core, prim)))
        start += core
    for job, result in zip(group, results, strict=True):
        prim = job.source.prim
        if result is not None:
            run.guarded(_write, prim, run, result, run.part(start, rest, prim))
        start += rest


def _read(prim: Usd.Prim, run: Run) -> MeshJob | VaryingTopologyError:
    """A mesh, or that it has several topologies."""
    try:
        return run.read(prim)
    except VaryingTopologyError as error:
        return error


def _simplify(_: Usd.Prim, run: Run, job: MeshJob, progress: Progress) -> MeshResult | None:
    return run.simplify_read(job, progress)


def _write(_: Usd.Prim, run: Run, result: MeshResult, progress: Progress) -> None:
    run.write(result, progress)
