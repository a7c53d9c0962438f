"""Frames of one mesh placed by several processes.

The process that has ordered a mesh lays what placing needs into a folder, and lets others know of it. It places the
frames from the first one on; the others take blocks from the last one on, and leave what they placed in the folder.
Who does a block makes no difference to a single bit, so that nothing depends on the others: a block that one has
claimed but not delivered, because it is slow or has died, is placed again.

All of it goes by files that appear whole or not at all, so that the processes need nothing in common but the folder.
"""

from __future__ import annotations

import logging
import os
import pickle
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from warpqem.arguments.number_input import shown, whole_number
from warpqem.errors import OptionError
from warpqem.files.temporary import remove_path
from warpqem.frames.stream import read_ahead
from warpqem.mesh.mesh_input import AnimatedMesh
from warpqem.place.block_placer import BlockPlacer, ClusterData, PlacedFrames
from warpqem.place.place import Placer
from warpqem.runtime.device import device_turn, resolve_device

__all__ = ["FrameShare", "check_share", "help_place", "placed_blocks"]

# Meshes with fewer bytes of input are placed before another process has looked: some tenths of a second.
MIN_BYTES = 64 * 2**20

_WORK = "work.pickle"

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class FrameShare:
    """How a process lets others place frames with it.

    Attributes:
        make_folder: gives the path of a folder, not there yet, that the others can reach. It is removed at the end.
        call: lets the others know of a folder with work, for :func:`help_place`; may be called once for each mesh.
        min_bytes: bytes of input frames from which a mesh is shared.
    """

    make_folder: Callable[[], Path]
    call: Callable[[Path], None]
    min_bytes: int = MIN_BYTES


def check_share(share: Any) -> None:
    """Raise an OptionError for what is neither None nor a :class:`FrameShare` with functions and a number of bytes."""
    if share is None:
        return
    if not isinstance(share, FrameShare):
        raise OptionError(f"share must be a FrameShare or None, got {shown(share)}")
    for name in ("make_folder", "call"):
        if not callable(getattr(share, name)):
            raise OptionError(f"share.{name} must be a function, got {shown(getattr(share, name))}")
    whole_number(share.min_bytes, "share.min_bytes", least=0)


@dataclass(frozen=True)
class _Work:
    """What the others need."""

    mesh: AnimatedMesh
    clusters: ClusterData
    blocks: Sequence[slice]
    device: str


class _Folder:
    """The files by which processes agree on who places which block."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def claim(self, frames: slice) -> bool:
        """Whether these frames are for this process to place, as nobody else has claimed them."""
        try:
            os.close(os.open(self.path / f"{frames.start}.claimed", os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600))
        except FileExistsError:
            return False
        return True

    def deliver(self, frames: slice, placed: PlacedFrames) -> None:
        """Leave frames for the process whose mesh it is."""
        part = self.path / f"{frames.start}.part"
        with open(part, "wb") as file:
            np.save(file, placed.to_rows())
        os.replace(part, self._placed(frames))

    def take(self, frames: slice, vertex_count: int) -> PlacedFrames | None:
        """Frames that another process left; None if it has not yet."""
        try:
            placed = PlacedFrames.from_rows(np.load(self._placed(frames)), vertex_count)
        except FileNotFoundError:
            return None
        self._placed(frames).unlink()
        return placed

    def _placed(self, frames: slice) -> Path:
        return self.path / f"{frames.start}.placed.npy"


def placed_blocks(
    mesh: AnimatedMesh, placer: Placer, blocks: Sequence[slice], share: FrameShare | None
) -> Iterator[tuple[slice, PlacedFrames]]:
    """All frames, placed, block by block; ``share`` lets others take a part in it.

    Raises:
        OptionError: the mesh is to be shared, and its source of frames cannot be pickled.
    """
    frame_bytes = 3 * mesh.source.dtype.itemsize * mesh.vertex_count
    if share is None or len(blocks) < 2 or mesh.frame_count * frame_bytes < share.min_bytes:
        for frames, points in read_ahead(mesh.points, blocks):
            yield frames, placer.place(mesh, points)
        return
    folder = _Folder(share.make_folder())
    folder.path.mkdir(mode=0o700)
    try:
        _lay_out(folder, _Work(mesh, placer.clusters, blocks, placer.device))
        share.call(folder.path)
        yield from _place_own(folder, mesh, placer, blocks)
    finally:
        remove_path(folder.path)


def _place_own(
    folder: _Folder, mesh: AnimatedMesh, placer: Placer, blocks: Sequence[slice]
) -> Iterator[tuple[slice, PlacedFrames]]:
    taken = 0

    def fetch(frames: slice) -> np.ndarray | PlacedFrames:
        if folder.claim(frames):
            return mesh.points(frames)
        placed = folder.take(frames, placer.vertex_count)
        return mesh.points(frames) if placed is None else placed

    for frames, block in read_ahead(fetch, blocks):
        if isinstance(block, PlacedFrames):
            taken += 1
            yield frames, block
        else:
            yield frames, placer.place(mesh, block)
    _log.info("%d of %d blocks of frames were placed by other processes", taken, len(blocks))


def _lay_out(folder: _Folder, work: _Work) -> None:
    try:
        data = pickle.dumps(work, protocol=pickle.HIGHEST_PROTOCOL)
    except (pickle.PicklingError, TypeError, AttributeError) as error:
        raise OptionError(f"share: frames cannot be read in another process ({error})") from error
    part = folder.path / f"{_WORK}.part"
    part.write_bytes(data)
    os.replace(part, folder.path / _WORK)


def help_place(folder: str | os.PathLike[str], device: str | None = None) -> int:
    """Place frames of a mesh that another process shares, until none are left that nobody has claimed.

    Args:
        folder: what that process's :attr:`FrameShare.call` was called with. It is read with :mod:`pickle`, which runs
            what it is told to: only from processes that are trusted.
        device: Warp device; None for the one that process uses. Only one of the same kind gives the same bits, so that
            a CPU is not taken where that process has a GPU, nor the other way round.

    Returns:
        How many blocks of frames were placed; 0 also where all is done already.

    Raises:
        OptionError: ``folder`` is no path.
        DeviceError: there is no such device.
    """
    if not isinstance(folder, (str, os.PathLike)):
        raise OptionError(f"folder must be a path, got {shown(folder)}")
    if device is not None:
        resolve_device(device)
    place = _Folder(Path(folder))
    try:
        work: Any = pickle.loads((place.path / _WORK).read_bytes())
        return _place_for_other(place, work, device)
    except FileNotFoundError:
        # The other process has all its frames, and has removed the folder.
        if place.path.exists():
            raise
        return 0


def _place_for_other(folder: _Folder, work: _Work, device: str | None) -> int:
    own = resolve_device(device or work.device)
    delivered = 0

    def fetch(frames: slice) -> np.ndarray | None:
        return work.mesh.points(frames) if folder.claim(frames) else None

    with device_turn(own if _is_cpu(own) == _is_cpu(work.device) else work.device) as used:
        placer = BlockPlacer(work.clusters, used)
        for frames, points in read_ahead(fetch, work.blocks[::-1]):
            if points is not None:
                folder.deliver(frames, placer.place(work.mesh, points))
                delivered += 1
    return delivered


def _is_cpu(device: str) -> bool:
    return bool(wp.get_device(device).is_cpu)
