"""Pieces of one mesh in a block of frames: which of them are proved to be within the limit of the other mesh.

A piece is within the limit of one face in the frame it was cut in. In the others that is looked at for many frames at
once (:mod:`warpqem.kernels.distance_pieces`). Where it does not hold, the piece is cut anew in the middle one of these
frames, and what it is cut into is looked at in the rest of them; and so on.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.frames.blocks import block_width
from warpqem.kernels import distance_bound as kernels
from warpqem.kernels.distance_pieces import check_pieces
from warpqem.measure.unit_frames import UnitBlock
from warpqem.runtime.cpu_threads import run_parts, split_range, thread_count
from warpqem.runtime.launches import launch
from warpqem.runtime.part_launches import PerPart, launch_in_parts, rows_of

if TYPE_CHECKING:
    from warpqem.measure.bound_side import BoundSide

__all__ = [
    "AROUND",
    "FEW_LOOKS",
    "MORE_ROOM",
    "NO_ROOM",
    "SEARCH",
    "WALK",
    "WITHIN",
    "PieceArrays",
    "PieceProof",
    "count_bits",
    "run_writing",
]

WITHIN, NO_ROOM = int(kernels.WITHIN), int(kernels.NO_ROOM)
WALK, AROUND, SEARCH = int(kernels.WALK), int(kernels.AROUND), int(kernels.SEARCH)
# Triangles and pieces that are worth a thread: some microseconds and some tens of nanoseconds each.
MIN_PART = 256
MIN_PIECES = 4096
# Room for the parts of a piece that is cut anew: most are two to four.
PARTS_PER_PIECE = 8
# Where that is too little, so many times the room.
MORE_ROOM = 4
# Rounding in single precision of points of unit size, their weights and distances: each of some ten operations adds
# no more than half a unit in the last place, 6e-8.
SINGLE_MARGIN = 1.0e-6
# Pieces are cut anew so often, as long as each is left in so many frames: one frame costs as much as looking at the
# parts in some twenty.
ROUNDS = 6
LEFT_FRAMES = 3
# So few looks at one piece in one frame each take as long as it takes to start a launch, or to search a frame.
FEW_LOOKS = 1024
# Bits set in each number of one byte: frames of a block.
_BIT_COUNT = ((np.arange(256)[:, None] >> np.arange(8)) & 1).sum(axis=1, dtype=np.int64)


def count_bits(frames: npt.NDArray[np.int32]) -> int:
    """How many bits are set, pairs of a piece and a frame."""
    return int(_BIT_COUNT[np.ascontiguousarray(frames).view(np.uint8)].sum())


@dataclass(frozen=True)
class PieceArrays:
    """Pieces on the host, see :class:`warpqem.kernels.distance_bound.Pieces`."""

    parent: npt.NDArray[np.int32]
    owner: npt.NDArray[np.int32]
    face: npt.NDArray[np.int32]
    weight: npt.NDArray[np.float32]

    @classmethod
    def none(cls) -> PieceArrays:
        """No piece."""
        none = np.zeros(0, np.int32)
        return cls(none, none, none, np.zeros((0, 3, 4), np.float32))

    @classmethod
    def joined(cls, parts: Sequence[PieceArrays]) -> PieceArrays:
        """All of several."""
        names = ("parent", "owner", "face", "weight")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def chosen(self, wanted: npt.NDArray[Any]) -> PieceArrays:
        """Some of them, by a mask or indices."""
        # Rows are taken by their numbers several times as fast as by a mask.
        rows = np.flatnonzero(wanted) if wanted.dtype == bool else wanted
        parent, owner, face = (array.take(rows) for array in (self.parent, self.owner, self.face))
        return PieceArrays(parent, owner, face, self.weight.take(rows, axis=0))

    def part(self, part: slice) -> PieceArrays:
        """Consecutive ones."""
        return PieceArrays(self.parent[part], self.owner[part], self.face[part], self.weight[part])

    def on_device(self, device: str) -> kernels.Pieces:
        """The same for kernels."""
        pieces = kernels.Pieces()
        pieces.parent = wp.array(self.parent, dtype=wp.int32, device=device, copy=False)
        pieces.owner = wp.array(self.owner, dtype=wp.int32, device=device, copy=False)
        pieces.face = wp.array(self.face, dtype=wp.int32, device=device, copy=False)
        pieces.weight = wp.array(self.weight, dtype=wp.float32, device=device, copy=False)
        return pieces

    def __len__(self) -> int:
        return len(self.owner)


def run_writing(
    work: Callable[[slice, wp.array, kernels.Pieces], object], count: int, room: int, device: str
) -> PieceArrays:
    """Run launches over ``count`` items that write pieces, as far as there is room for them.

    ``work`` gets its part of the items, the counter (1,) of what it wrote, and where to write.
    """
    parts = split_range(count, max(1, min(thread_count(device), count // MIN_PART)))
    # Each thread has a part of the room of its own.
    size = -(-room // len(parts))
    written: list[PieceArrays] = [PieceArrays.none()] * len(parts)

    def run(number: int, part: slice) -> None:
        pieces = kernels.Pieces()
        pieces.parent, pieces.owner, pieces.face = (wp.empty(size, dtype=wp.int32, device=device) for _ in range(3))
        pieces.weight = wp.empty((size, 3, 4), dtype=wp.float32, device=device)
        used = wp.zeros(1, dtype=wp.int32, device=device)
        work(part, used, pieces)
        if size:
            count = min(int(used.numpy()[0]), size)
            arrays = (pieces.parent, pieces.owner, pieces.face, pieces.weight)
            written[number] = PieceArrays(*(array.numpy()[:count].copy() for array in arrays))

    run_parts([functools.partial(run, number, part) for number, part in enumerate(parts)])
    return PieceArrays.joined(written)


class PieceProof:
    """Looks at pieces of ``own`` in a block of frames.

    Args:
        own: the mesh of the pieces.
        other: the other one.
        own_block: the frames of ``own``.
        other_block: those of the other one.
        limit: distance.
        device: Warp device.

    Attributes:
        relied_on: pairs (n, 2) of faces, of ``own`` and of the other mesh that in some frame is within the limit of a
            part of it, beside the pieces.
    """

    def __init__(
        self, own: BoundSide, other: BoundSide, own_block: UnitBlock, other_block: UnitBlock, limit: float, device: str
    ) -> None:
        self._own, self._other, self._blocks = own, other, (own_block, other_block)
        self._limit, self._device = limit, device
        self.relied_on: list[npt.NDArray[np.int32]] = []
        self._width = block_width(len(own_block), device)

    def unproved(
        self, pieces: PieceArrays, left: npt.NDArray[np.int32]
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int32]]:
        """Pieces (n,) that are not proved without a search, of those left in some frames, bits (m, B).

        Returns:
            Their indices, and the bits (n, B) of the frames in which they are not.
        """
        unproved = np.zeros_like(left)
        at = np.arange(len(pieces))
        # What no walk leads to, in any frame, is mostly too far: that is looked at in one frame before the others.
        lost: list[tuple[npt.NDArray[np.int64], npt.NDArray[np.int32]]] = []
        for effort in (*[WALK] * ROUNDS, AROUND):
            if effort == AROUND and lost:
                at, left = (np.concatenate(parts) for parts in zip((at, left), *lost, strict=True))
                lost = []
            elif effort == AROUND or count_bits(left) <= max(LEFT_FRAMES * len(at), FEW_LOOKS):
                continue
            before = left
            frame, left = self._take_middle(left)
            verdict, parts = self._cut_anew(pieces.chosen(at), frame, effort=effort)
            missed = verdict != WITHIN
            if effort == WALK:
                lost.append((at[missed], before[missed]))
            elif count_bits(before[missed]) > FEW_LOOKS:
                unproved[at[missed]] = before[missed]
            else:
                lost = [(at[missed], before[missed])]
            at, left = at[~missed], self._left_of_parts(left, parts, ~missed)[~missed]
            keep = left.any(axis=1)
            at, left = at[keep], left[keep]
        at, left = (np.concatenate(parts) for parts in zip((at, left), *lost, strict=True))
        row, frame = self._frames_of(left)
        row = at[row]
        if len(row):
            verdict, parts = self._cut_anew(pieces.chosen(row), frame, effort=AROUND)
            self._rely_on(parts)
            missed = verdict != WITHIN
            self._set_bits(unproved, row[missed], frame[missed])
        rows = np.flatnonzero(unproved.any(axis=1))
        return rows, unproved[rows]

    def most_common(self, left: npt.NDArray[np.int32]) -> int:
        """The frame that most of the bits (n, B) are of."""
        return int(self._flags(left).sum(axis=0, dtype=np.int32).argmax())

    def search(
        self, pieces: PieceArrays, left: npt.NDArray[np.int32], frame: int
    ) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.int32]]:
        """Search for what is near to pieces, in the frame that the other mesh shows.

        Returns:
            The pieces (n,) that are not within the limit there, and the bits (n, B) of the frames in which the others
            are not proved yet.
        """
        here = np.flatnonzero((left[:, frame // self._width] >> (frame % self._width)) & 1)
        left, beyond = left.copy(), np.zeros(len(left), dtype=bool)
        left[:, frame // self._width] &= ~np.int32(1 << (frame % self._width))
        # A search looks at all corners first, as most that are searched for alone are beyond; of many, few are.
        for effort in (WALK, SEARCH) if len(here) > FEW_LOOKS else (SEARCH,):
            verdict, parts = self._cut_anew(pieces.chosen(here), np.full(len(here), frame), effort=effort)
            missed = verdict != WITHIN
            left[here] = self._left_of_parts(left[here], parts, ~missed)
            here = here[missed]
        beyond[here] = True
        return beyond, left

    def apart_somewhere(self, pieces: PieceArrays) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int32]]:
        """Pieces that are not proved in all frames by the faces they are over, and bits of the others (n, B)."""
        frame_count = len(self._blocks[0])
        every = (np.arange(-(-frame_count // self._width) * self._width) < frame_count).reshape(-1, self._width)
        bits = (every * (1 << np.arange(self._width))).sum(axis=1, dtype=np.int32)
        pieces = PieceArrays(np.zeros(len(pieces), np.int32), pieces.owner, pieces.face, pieces.weight)
        apart = self._apart(pieces, bits[None])
        rows = np.flatnonzero(apart.any(axis=1))
        return rows, apart[rows]

    def _apart(self, pieces: PieceArrays, left: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
        """Of the frames left (P, B), by parent, those in which pieces are not proved by the face they are over."""
        if not len(pieces) or self._limit <= 2.0 * SINGLE_MARGIN:
            # Single precision does not resolve such distances.
            return left[pieces.parent]
        own, other, device = self._own, self._other, self._device
        points, others = self._blocks[0].lanes, self._blocks[1].lanes
        apart = wp.empty((len(pieces), left.shape[1]), dtype=wp.int32, device=device)
        left_device = wp.array(left, dtype=wp.int32, device=device, copy=False)
        squared = (self._limit - SINGLE_MARGIN) ** 2
        of_part = PerPart(lambda part: pieces.part(part).on_device(device))
        launch_in_parts(
            check_pieces[self._width],
            apart.shape,
            inputs=[points, others, own.corner_vertex, other.corner_vertex, of_part, squared, left_device],
            outputs=[rows_of(apart)],
            device=device,
            min_items=MIN_PIECES,
        )
        bits: npt.NDArray[np.int32] = apart.numpy()
        return bits

    def _frames_of(self, left: npt.NDArray[np.int32]) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        """Rows and frames of bits (n, B)."""
        place = np.flatnonzero(self._flags(left))
        row = place // (left.shape[1] * self._width)
        return row, place - row * (left.shape[1] * self._width)

    def _flags(self, left: npt.NDArray[np.int32]) -> npt.NDArray[np.uint8]:
        """Bits (n, B) as numbers 0 and 1 of each frame, (n, F)."""
        lanes = np.unpackbits(left.astype(np.uint8), bitorder="little").reshape(*left.shape, 8)
        # Of no pieces the number of frames cannot be inferred.
        return lanes[..., : self._width].reshape(len(left), left.shape[1] * self._width)

    def _set_bits(self, bits: npt.NDArray[np.int32], row: npt.NDArray[np.int64], frame: npt.NDArray[np.int64]) -> None:
        """Set the bits of frames in rows."""
        np.bitwise_or.at(bits, (row, frame // self._width), (1 << (frame % self._width)).astype(np.int32))

    def _take_middle(self, left: npt.NDArray[np.int32]) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int32]]:
        """The middle one of the frames of each row, of which each has some, and the bits without it."""
        row, frame = self._frames_of(left)
        start = np.searchsorted(row, np.arange(len(left) + 1))
        middle: npt.NDArray[np.int64] = frame[(start[:-1] + start[1:]) // 2]
        left = left.copy()
        left[np.arange(len(left)), middle // self._width] &= ~(1 << (middle % self._width)).astype(np.int32)
        return middle, left

    def _left_of_parts(
        self, left: npt.NDArray[np.int32], parts: PieceArrays, usable: npt.NDArray[np.bool_]
    ) -> npt.NDArray[np.int32]:
        """Bits in which the parts of a piece do not prove it, where they are usable."""
        parts = parts.chosen(usable[parts.parent])
        self._rely_on(parts)
        parts = parts.chosen(np.argsort(parts.parent, kind="stable"))
        if len(parts):
            apart = self._apart(parts, left)
            start = np.flatnonzero(np.diff(parts.parent, prepend=-1))
            left = left.copy()
            left[parts.parent[start]] = np.bitwise_or.reduceat(apart, start, axis=0)
        return left

    def _rely_on(self, parts: PieceArrays) -> None:
        self.relied_on.append(np.stack([parts.owner, parts.face], axis=1))

    def _cut_anew(
        self, pieces: PieceArrays, frame: npt.NDArray[np.int64], *, effort: int = WALK
    ) -> tuple[npt.NDArray[np.int32], PieceArrays]:
        """Verdicts on pieces in a frame each, and their parts."""
        device = self._device
        verdict = wp.empty(len(pieces), dtype=wp.int32, device=device)
        surfaces = [self._blocks[0].double, self._blocks[1].double, self._own.surface, self._other.surface]
        given = [pieces.on_device(device), wp.array(frame.astype(np.int32), dtype=wp.int32, device=device)]

        def bound(part: slice, used: wp.array, parts: kernels.Pieces) -> None:
            launch(
                kernels.bound_pieces,
                dim=part.stop - part.start,
                inputs=[*surfaces, self._limit, effort, *given, part.start, used],
                outputs=[parts, verdict],
                device=device,
            )

        room = PARTS_PER_PIECE * len(pieces) + MIN_PIECES
        while True:
            parts = run_writing(bound, len(pieces), room, device)
            verdicts: npt.NDArray[np.int32] = verdict.numpy()
            if not (verdicts == NO_ROOM).any():
                return verdicts, parts
            room *= MORE_ROOM
