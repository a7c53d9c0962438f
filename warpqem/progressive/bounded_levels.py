"""Levels of a progressive mesh by their distance from its finest level, which is the input: proved, and measured."""

from __future__ import annotations

import numpy as np

from warpqem.arguments.distance_limit import DistanceLimit
from warpqem.frames.stream import ArrayFrames, NoFrames
from warpqem.measure.measured import Measured, measure_frames, measured_errors
from warpqem.mesh.mesh_input import MeshInput, measure_mesh, read_mesh
from warpqem.pipeline.bound_sink import BoundSink, ExceededError
from warpqem.progressive.progressive_mesh import MeshLevel, ProgressiveMesh
from warpqem.runtime.device import on_device, resolve_device

__all__ = ["coarsest_within", "measured_level"]


@on_device
def coarsest_within(mesh: ProgressiveMesh, limit: DistanceLimit, *, device: str | None = None) -> int:
    """The splits of the coarsest level that is proved to be within a limit of the input, both ways and in all frames.

    It is found by bisection, from the level that is within it by the estimates: a finer level is taken to be within the
    limit where a coarser one is.

    Args:
        mesh: with all splits.
        limit: the limit.
        device: Warp device.

    Raises:
        DegenerateMeshError: the mesh has no extent.
    """
    finest = mesh.level(mesh.split_count)
    reference = read_mesh(finest.points, finest.faces)
    name = resolve_device(device)
    diagonal = measure_mesh(reference, name).diagonal
    # The finest level is the input itself.
    low, high = -1, mesh.split_count
    # Estimates fall from split to split.
    estimated = np.flatnonzero(mesh.topology.error[:high] <= limit.relative(diagonal))
    middle = int(estimated[0]) if len(estimated) else high - 1
    while high - low > 1:
        if _is_within(reference, mesh.level(middle), limit, diagonal, name):
            high = middle
        else:
            low = middle
        middle = (low + high) // 2
    return high


def _is_within(reference: MeshInput, level: MeshLevel, limit: DistanceLimit, diagonal: float, device: str) -> bool:
    bound = BoundSink(NoFrames(), reference, limit, diagonal, device)
    frame_count, vertex_count = level.points.shape[:2]
    bound.begin(frame_count, vertex_count, level.faces)
    try:
        bound.write(slice(0, frame_count), level.points)
    except ExceededError:
        return False
    return True


@on_device
def measured_level(mesh: ProgressiveMesh, level: MeshLevel, *, device: str | None = None) -> Measured:
    """The measured errors of a level of a mesh with all splits, against its finest one."""
    finest = mesh.level(mesh.split_count)
    frames = range(mesh.frame_count)
    one, other = ArrayFrames(finest.points), ArrayFrames(level.points)
    return measured_errors(
        measure_frames(one, finest.faces, other, level.faces, frames, device=resolve_device(device), overall=True)
    )
