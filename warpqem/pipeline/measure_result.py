"""The measured errors of a result: of frames in memory when they are asked for, of a stream on its way to the sink."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from warpqem.errors import UnreachableTargetError
from warpqem.frames.stream import ArrayFrames, FrameSink, FrameSource, SharedFrames
from warpqem.measure.measured import Measured, MeasuringSink, measure_frames, measured_errors
from warpqem.mesh.mesh_input import MeshInput
from warpqem.pipeline.prepare import Prepared
from warpqem.pipeline.result import SimplifiedMesh, on_result_device
from warpqem.runtime.device import device_turn

__all__ = ["ResultMeasure", "measured_on_the_way", "with_errors"]


@dataclass(frozen=True)
class ResultMeasure:
    """Measures a result whose frames are in memory.

    Attributes:
        source: frames of the input, which are read once more.
        faces: (N, 3) faces of the input, as the caller gave them.
        device: Warp device.
    """

    source: FrameSource
    faces: np.ndarray
    device: str

    @classmethod
    def of(cls, mesh: MeshInput, device: str) -> ResultMeasure:
        """Against a mesh that was read."""
        return cls(mesh.source, mesh.given_faces, device)

    def __call__(self, result: SimplifiedMesh) -> Measured:
        """The errors of a result."""
        with device_turn(self.device) as device:
            result = result.numpy()
            frames = range(len(result.points))
            test = ArrayFrames(result.points)
            return measured_errors(
                measure_frames(self.source, self.faces, test, result.faces, frames, device=device, overall=True)
            )


def measured_on_the_way(work: Prepared, sink: FrameSink) -> tuple[Prepared, MeasuringSink]:
    """A sink that measures before it passes on, and the mesh with frames that it can read while others do."""
    source = SharedFrames(work.mesh.source)
    shared = replace(work, mesh=replace(work.mesh, source=source))
    return shared, MeasuringSink(sink, source, work.mesh.given_faces, work.device)


def with_errors(
    simplify: Callable[[], SimplifiedMesh],
    measuring: Callable[[SimplifiedMesh], Measured] | None,
    device: str | None = None,
) -> SimplifiedMesh:
    """What a function gives, or its error has, with the way to measure it, and arrays on the device; None for none."""
    try:
        result = simplify()
        return on_result_device(replace(result, log=result.log.made(), measuring=measuring), device)
    except UnreachableTargetError as error:
        if error.result is not None:
            error.result = on_result_device(replace(error.result, measuring=measuring), device)
        raise
