"""After decimation: place all frames, refit them where that is asked for, and hand them on, block by block."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import warp as wp

from warpqem.frames.device_frames import DeviceSink
from warpqem.frames.stream import FrameSink, FrameWriter, read_ahead
from warpqem.mesh.mesh_input import AnimatedMesh
from warpqem.place.block_placer import PlacedBlocks, PlacedFrames, PointsUnderWay
from warpqem.place.frame_store import AnyFrameStore, DeviceFrameStore, FrameStore
from warpqem.place.place import Placer
from warpqem.refit.fit_surface import fit_corrections
from warpqem.refit.fit_under_way import FitUnderWay
from warpqem.runtime.device import device_traits
from warpqem.runtime.readback import joined, read_together
from warpqem.runtime.staging import Download, Downloads, work_copies

__all__ = ["FinishedFrames", "Placing", "Settling", "place_frames", "place_refitted"]

Progress = Callable[[int], None] | None


@dataclass(frozen=True)
class FinishedFrames:
    """What is known of the frames once they are with the sink.

    Attributes:
        flips: (F,) int32, output faces of each frame that face away from the input; none where they are not counted.
        first: (1, C, 3) float32, the first frame in the caller's coordinates, where it came to the host.
    """

    flips: np.ndarray
    first: np.ndarray


@dataclass(frozen=True)
class Placing:
    """What it takes to place the frames of a mesh.

    Attributes:
        mesh: the input.
        placer: what places its frames.
        sink: takes them.
        blocks: frames to work on at once.
        faces: (N', 3) int32, the faces that the sink is to have.
        progress: called with the number of frames placed.
    """

    mesh: AnimatedMesh
    placer: Placer
    sink: FrameSink
    blocks: Sequence[slice]
    faces: np.ndarray
    progress: Progress = None

    def placed(self) -> Iterator[tuple[slice, PlacedBlocks]]:
        """All frames, block by block."""
        for frames, points in self.mesh.device_blocks(self.blocks, self.placer.device):
            yield frames, self.placer.place(self.mesh, points)
            if self.progress:
                self.progress(frames.stop)


class Settling(Protocol):
    """Decides which vertices a refit leaves as they were placed, by looking at all frames as often as it takes.

    Attributes:
        held: (C,) bool, these vertices.
    """

    held: np.ndarray

    def is_settled(self) -> bool:
        """Whether the frames that the sink got were the last ones; else more vertices are held from now on."""
        ...


class _Finish:
    """Counts flips, brings frames back to the caller's coordinates, and hands them to a sink on a thread."""

    def __init__(self, work: Placing, counts_flips: bool = True) -> None:
        self._mesh, self._placer, self._counts_flips = work.mesh, work.placer, counts_flips
        self._sink = work.sink
        self._there = work.sink if isinstance(work.sink, DeviceSink) else None
        self._under_way: tuple[slice, PointsUnderWay] | None = None
        self._downloads = Downloads(work_copies(work.placer.device, len(work.blocks)))
        self._first = np.empty((1, 0, 3), dtype=np.float32)
        self._flips: list[np.ndarray] = []
        self._flips_there: list[wp.array] = []
        work.sink.begin(work.mesh.frame_count, work.placer.vertex_count, work.faces)

    def take(self, frames: slice, placed: PlacedBlocks, write: FrameWriter[PointsUnderWay]) -> None:
        """Finish consecutive frames; they are brought to the host while the device works on the next ones."""
        if self._there is not None:
            placed.restored(self._mesh, self._there.room(frames))
            if self._counts_flips:
                self._flips_there.append(self._placer.count_flips(placed))
            return
        flips = self._placer.count_flips(placed) if self._counts_flips else None
        begun = placed.begin_download(self._mesh, flips, self._downloads)
        self.hand_on(write)
        self._under_way = frames, begun
        if self._downloads.at_once:
            self.hand_on(write)

    def took_fitted(
        self, frames: slice, kept: PlacedFrames, fit: FitUnderWay, write: FrameWriter[PointsUnderWay]
    ) -> bool:
        """Finish the first frames with what says whether a fit is final: the host waits once for both.

        False where it was final before, or is now by another way than it seemed.
        """
        while fit.pending is not None:
            count = len(fit.pending)
            placed = self._placer.to_blocks(self._mesh, fit.apply(kept))
            flips = [self._placer.count_flips(placed)] if self._counts_flips else []
            begun = placed.begin_download(self._mesh, joined([*flips, fit.pending]), self._downloads)
            begun.download.wait()
            numbers = begun.download.result()
            if fit.stands(numbers[-count:].view(np.int32)):
                write(frames, replace(begun, download=Download.of(numbers[:-count])))
                return True
        return False

    def hand_on(self, write: FrameWriter[PointsUnderWay]) -> None:
        """Have the frames that are under way written, if there are any; they are to be the last ones in the end."""
        if self._under_way is not None:
            (frames, begun), self._under_way = self._under_way, None
            begun.download.wait()
            write(frames, begun)

    def written(self, frames: slice, brought: PointsUnderWay) -> None:
        """Hand consecutive frames to the sink, in their order."""
        points, flips = brought.result()
        if self._counts_flips:
            self._flips.append(flips)
        if frames.start == 0:
            self._first = points[:1].copy()
        self._sink.write(frames, points)

    def finished(self) -> FinishedFrames:
        """What is known of all frames."""
        flips = read_together(*self._flips_there) if self._flips_there else self._flips
        return FinishedFrames(np.concatenate(flips or [np.empty(0, dtype=np.int32)]), self._first)


def place_frames(work: Placing) -> FinishedFrames:
    """Place all frames straight from the source to the sink."""
    finish = _Finish(work)
    with FrameWriter(finish.written, len(work.blocks)) as write:
        for frames, placed in work.placed():
            finish.take(frames, placed, write)
        finish.hand_on(write)
    return finish.finished()


def place_refitted(
    work: Placing,
    *,
    key_frames: np.ndarray,
    error: float,
    recent_error: float,
    on_disk: bool,
    settling: Settling | None = None,
    roughly: bool = False,
) -> FinishedFrames:
    """Place all frames into a store, fit the corrections, and hand the corrected frames to the sink.

    Args:
        work: what to place.
        key_frames: (K,) int, the frames to fit.
        error: the largest error of a collapse, in diagonals.
        recent_error: the root mean square of the errors of the last collapses, in diagonals.
        on_disk: keep the placed frames in a temporary file.
        settling: leaves vertices as placed; the sink begins anew each time that there are more.
        roughly: see :func:`warpqem.refit.fit_surface.fit_corrections`; flips are not counted then.
    """
    placer = work.placer
    with _stored(work, on_disk, settling is None) as store:
        fit = fit_corrections(
            work.mesh, placer, store, key_frames, error, recent_error, work.blocks, placer.device, roughly
        )
        if settling is not None or isinstance(work.sink, DeviceSink) or not device_traits(placer.device).own_memory:
            fit.complete()
        while True:
            finish = _Finish(work, counts_flips=not roughly)
            with FrameWriter(finish.written, len(work.blocks)) as write:
                for frames, kept in read_ahead(store.read, work.blocks):
                    if finish.took_fitted(frames, kept, fit, write):
                        continue
                    moved = fit.apply(kept)
                    if settling is not None:
                        moved = replace(moved, points=np.where(settling.held[:, None], kept.points, moved.points))
                    finish.take(frames, placer.to_blocks(work.mesh, moved), write)
                finish.hand_on(write)
            if settling is None or settling.is_settled():
                break
    return finish.finished()


@contextlib.contextmanager
def _stored(work: Placing, on_disk: bool, there: bool) -> Iterator[AnyFrameStore]:
    """All placed frames within, on the device if they may be ``there`` and it has memory of its own."""
    placer = work.placer
    shape = work.mesh.frame_count, placer.vertex_count, placer.copied_count
    if there and not on_disk and device_traits(placer.device).own_memory:
        there_store = DeviceFrameStore(*shape, placer.device)
        for frames, placed in work.placed():
            placed.fill(there_store.room(frames))
        yield there_store
        return
    store = FrameStore(*shape, on_disk)
    try:
        with FrameWriter(store.write, len(work.blocks)) as keep:
            for frames, placed in work.placed():
                keep(frames, placed.fetch())
        yield store
    finally:
        store.close()
