"""After ordering: place all frames, refit them where that is asked for, and hand them on, block by block."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from warpqem.frame_stream import FrameSink, FrameWriter, read_ahead
from warpqem.mesh_input import AnimatedMesh
from warpqem.place.blocks import PlacedFrames
from warpqem.place.stage import Placer
from warpqem.place.store import FrameStore
from warpqem.refit.stage import fit_corrections
from warpqem.sharing import FrameShare, placed_blocks

__all__ = ["FinishedFrames", "place_frames", "place_refitted"]

Progress = Callable[[int], None] | None


@dataclass
class FinishedFrames:
    """What is known of the frames once they are with the sink.

    Attributes:
        flips: (F,) int32, output faces of each frame that face away from the input.
        first: (1, C, 3) float32, the first frame in the caller's coordinates.
    """

    flips: np.ndarray
    first: np.ndarray = field(default_factory=lambda: np.empty((1, 0, 3), dtype=np.float32))


class _Finish:
    """Counts flips, brings frames back to the caller's coordinates, and hands them to a sink on a thread."""

    def __init__(self, mesh: AnimatedMesh, placer: Placer, sink: FrameSink) -> None:
        self._mesh, self._placer, self._sink = mesh, placer, sink
        self.finished = FinishedFrames(np.empty(mesh.frame_count, dtype=np.int32))
        sink.begin(mesh.frame_count, placer.vertex_count, placer.faces)

    def take(self, frames: slice, placed: PlacedFrames, write: FrameWriter) -> None:
        """Finish consecutive frames."""
        self.finished.flips[frames] = self._placer.count_flips(self._mesh, placed)
        points = self._placer.original_points(self._mesh, placed)
        if frames.start == 0:
            self.finished.first = points[:1].copy()
        write(frames, points)


def place_frames(
    mesh: AnimatedMesh,
    placer: Placer,
    sink: FrameSink,
    blocks: Sequence[slice],
    progress: Progress = None,
    share: FrameShare | None = None,
) -> FinishedFrames:
    """Place all frames straight from the source to the sink; the arguments are those of :func:`place_refitted`."""
    finish = _Finish(mesh, placer, sink)
    with FrameWriter(sink.write, len(blocks)) as write:
        for frames, placed in placed_blocks(mesh, placer, blocks, share):
            finish.take(frames, placed, write)
            if progress:
                progress(frames.stop)
    return finish.finished


def place_refitted(
    mesh: AnimatedMesh,
    placer: Placer,
    sink: FrameSink,
    blocks: Sequence[slice],
    progress: Progress = None,
    share: FrameShare | None = None,
    *,
    key_frames: np.ndarray,
    error: float,
    on_disk: bool,
    device: str,
) -> FinishedFrames:
    """Place all frames into a store, fit the corrections, and hand the corrected frames to the sink.

    Args:
        mesh: the input.
        placer: what places its frames.
        sink: takes them.
        blocks: frames to work on at once.
        progress: called with the number of frames placed.
        share: lets other processes place some of them.
        key_frames: (K,) int, the frames to fit.
        error: the largest error of a collapse, in diagonals.
        on_disk: keep the placed frames in a temporary file.
        device: Warp device.
    """
    store = FrameStore(mesh.frame_count, placer.vertex_count, placer.copied_count, on_disk)
    try:
        with FrameWriter(store.write, len(blocks)) as keep:
            for frames, placed in placed_blocks(mesh, placer, blocks, share):
                keep(frames, placed)
                if progress:
                    progress(frames.stop)
        correct = fit_corrections(mesh, placer, store, key_frames, error, blocks, device)
        finish = _Finish(mesh, placer, sink)
        with FrameWriter(sink.write, len(blocks)) as write:
            for frames, placed in read_ahead(store.read, blocks):
                finish.take(frames, correct(placed), write)
    finally:
        store.close()
    return finish.finished
