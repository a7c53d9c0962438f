"""A bound on the distance between two meshes in motion that is proved for every point, not read off samples."""

from __future__ import annotations

import copy
import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.frames.blocks import block_width, pack_frames
from warpqem.kernels import distance_bound as kernels
from warpqem.kernels.distance_pieces import check_pieces
from warpqem.mesh.edges import edge_key
from warpqem.runtime.cpu_threads import launch_parts, run_parts, split_range, thread_count
from warpqem.runtime.launches import launch

__all__ = ["DistanceBound", "Excess", "UnitFrames", "faces_across"]

WITHIN, NO_ROOM = int(kernels.WITHIN), int(kernels.NO_ROOM)
# Triangles and pieces that are worth a thread: some microseconds and some tens of nanoseconds each.
MIN_PART = 256
MIN_PIECES = 4096
# Room for pieces, for each triangle: those of a triangle across a vertex of the other mesh are some ten.
PIECES_PER_FACE = 12
# Rounding in single precision of points of unit size, their weights and distances: each of some ten operations adds
# no more than half a unit in the last place, 6e-8.
SINGLE_MARGIN = 1.0e-6


@dataclass(frozen=True)
class UnitFrames:
    """How frames are brought to about unit size around the origin.

    Attributes:
        middle: (n, 3) float64, in the units of the points.
        unit: (n,) float64, the length that becomes one.
    """

    middle: npt.NDArray[np.float64]
    unit: npt.NDArray[np.float64]

    def single(self, points: npt.NDArray[np.floating]) -> npt.NDArray[np.float32]:
        """Points (n, V, 3) in single precision; of points in it the middle goes first, which costs no digit."""
        middle, scale = self.middle[:, None], (1.0 / self.unit)[:, None, None]
        if points.dtype != np.float32:
            return np.ascontiguousarray((points - middle) * scale, dtype=np.float32)
        placed = points - middle.astype(np.float32)
        placed *= scale.astype(np.float32)
        return placed

    def double(self, points: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
        """Points (n, V, 3) in double precision, about the same middles."""
        middle = self.middle
        if points.dtype == np.float32:
            middle = middle.astype(np.float32).astype(np.float64)
        placed = points - middle[:, None]
        placed *= (1.0 / self.unit)[:, None, None]
        return placed


@dataclass(frozen=True)
class Excess:
    """Faces that are not within the limit, in some frame.

    Attributes:
        frame: the first of these frames.
        reference_faces: int indices, faces of the reference too far from the test mesh, or not proved to be near.
        test_faces: the same the other way round.
    """

    frame: int
    reference_faces: npt.NDArray[np.int64]
    test_faces: npt.NDArray[np.int64]


@dataclass(frozen=True)
class PieceArrays:
    """Pieces on the host, see :class:`warpqem.kernels.distance_bound.Pieces`."""

    owner: npt.NDArray[np.int32]
    face: npt.NDArray[np.int32]
    weight: npt.NDArray[np.float32]

    @classmethod
    def none(cls) -> PieceArrays:
        """No piece."""
        return cls(np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros((0, 3, 4), np.float32))

    @classmethod
    def joined(cls, parts: Sequence[PieceArrays]) -> PieceArrays:
        """All of several."""
        names = ("owner", "face", "weight")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def chosen(self, wanted: npt.NDArray[np.bool_]) -> PieceArrays:
        """Some of them."""
        return PieceArrays(self.owner[wanted], self.face[wanted], self.weight[wanted])

    def part(self, part: slice) -> PieceArrays:
        """Consecutive ones."""
        return PieceArrays(self.owner[part], self.face[part], self.weight[part])

    def on_device(self, device: str) -> kernels.Pieces:
        """The same for kernels."""
        pieces = kernels.Pieces()
        pieces.owner = wp.array(self.owner, dtype=wp.int32, device=device, copy=False)
        pieces.face = wp.array(self.face, dtype=wp.int32, device=device, copy=False)
        pieces.weight = wp.array(self.weight, dtype=wp.float32, device=device, copy=False)
        return pieces


def faces_across(faces: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """(3N,) int32, for the edge from each corner to the next the face beyond it, of several one; -1 at a border."""
    tail, head = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    key = edge_key(tail, head, int(faces.max(initial=0)) + 1)
    order = np.argsort(key, kind="stable")
    same = key[order][1:] == key[order][:-1]
    across = np.full(len(key), -1, dtype=np.int32)
    across[order[:-1][same]] = order[1:][same] // 3
    across[order[1:][same]] = order[:-1][same] // 3
    return across


class _Side:
    """One of the two meshes: what is known of its faces, and itself in one frame on the device."""

    def __init__(
        self,
        faces: npt.NDArray[np.int32],
        device: str,
        hint: npt.NDArray[np.int32] | None,
        across: wp.array | None = None,
    ) -> None:
        if across is None:
            across = wp.array(faces_across(faces), dtype=wp.int32, device=device)
        self._device = device
        self._mesh: wp.Mesh | None = None
        self.faces = np.ascontiguousarray(faces, dtype=np.int32)
        self.surface = kernels.Surface()
        self.corner_vertex = wp.array(self.faces.ravel(), dtype=wp.int32, device=device, copy=False)
        self.surface.corner_vertex = self.corner_vertex
        self.surface.across = across
        hints = np.full((len(faces), int(kernels.HINTS)), -1, dtype=np.int32)
        if hint is not None:
            hints[:, 0] = hint
        self.hint = wp.array(hints, dtype=wp.int32, device=device)
        self.pieces = PieceArrays.none()
        # Faces whose pieces are there, faces to be looked at, and those that do not hold.
        self.recorded = np.zeros(len(faces), dtype=bool)
        self.active = np.ones(len(faces), dtype=bool)
        self.failed = np.zeros(len(faces), dtype=bool)

    @property
    def unrecorded(self) -> npt.NDArray[np.int64]:
        """Faces to be looked at that have no pieces."""
        return np.flatnonzero(self.active & ~self.recorded & ~self.failed)

    def inherit(
        self,
        old: _Side,
        owner: npt.NDArray[np.integer],
        face: npt.NDArray[np.integer],
        stays: npt.NDArray[np.bool_] | None,
    ) -> None:
        """Take over the pieces of ``old``, with new numbers of owners and faces, -1 for those that are no more.

        With ``stays``, faces of the other mesh that have not moved, what lies over these alone is proved.
        """
        pieces = old.pieces
        new_owner, new_face = owner[pieces.owner], face[pieces.face]
        broken = np.zeros(len(old.faces), dtype=bool)
        broken[pieces.owner[(new_face < 0) | (new_owner < 0)]] = True
        whole = old.recorded & ~broken & ~old.failed
        keep = whole[pieces.owner]
        self.pieces = PieceArrays(
            new_owner[keep].astype(np.int32), new_face[keep].astype(np.int32), pieces.weight[keep]
        )
        self.recorded[self.pieces.owner] = True
        if stays is not None:
            moved = np.zeros(len(old.faces), dtype=bool)
            moved[pieces.owner[~stays[pieces.face]]] = True
            self.active = ~(whole & ~moved)
        if self.faces is old.faces:
            self._mesh, self.surface.mesh = old._mesh, old.surface.mesh

    def show(self, block: UnitBlock, frame: int, *, searched: bool) -> None:
        """Show a frame; ``searched`` says whether the hierarchy is needed.

        The hierarchy is refitted from frame to frame: where it leads the search decides no verdict.
        """
        self.surface.points = block.double[frame]
        if searched:
            single = wp.array(self.surface.points.numpy().astype(np.float32), dtype=wp.vec3, device=self._device)
            if self._mesh is None:
                self._mesh = wp.Mesh(points=single, indices=self.corner_vertex)
            else:
                self._mesh.points = single
            self.surface.mesh = self._mesh.id


class UnitBlock:
    """A block of frames of one mesh at unit size, made as it is asked for and kept.

    Args:
        points: (n, V, 3), in the caller's coordinates.
        frames: what brings them to unit size.
        device: Warp device.
    """

    def __init__(self, points: npt.NDArray[np.floating], frames: UnitFrames, device: str) -> None:
        self._points, self._frames, self._device = points, frames, device

    def __len__(self) -> int:
        return len(self._points)

    @functools.cached_property
    def double(self) -> wp.array:
        """(n, V) double precision."""
        return wp.array(self._frames.double(self._points), dtype=wp.vec3d, device=self._device, copy=False)

    @functools.cached_property
    def lanes(self) -> wp.array:
        """(V, B) blocks of frames, single precision."""
        width = block_width(len(self), self._device)
        return pack_frames(self._frames.single(self._points), self._device, width=width)


class DistanceBound:
    """Proves that two meshes are within a limit of each other, both ways, in one block of frames after another.

    A face is cut into pieces that each are within the limit of one face of the other mesh in one frame; in others, the
    pieces are looked at first, many frames at once, and only where that proves nothing is the face cut anew.

    Args:
        reference_faces: (N, 3) int.
        test_faces: (M, 3) int.
        limit: in units of the points as :class:`UnitFrames` places them.
        device: Warp device.
        reference_hint: (N,) int, a face of the test mesh that may be near each face, -1 for none.
        test_hint: (M,) int, the same the other way round.
    """

    def __init__(
        self,
        reference_faces: npt.NDArray[np.int32],
        test_faces: npt.NDArray[np.int32],
        limit: float,
        device: str,
        reference_hint: npt.NDArray[np.int32] | None = None,
        test_hint: npt.NDArray[np.int32] | None = None,
    ) -> None:
        self._limit, self._device = float(limit), device
        self.reference = _Side(reference_faces, device, reference_hint)
        self.test = _Side(test_faces, device, test_hint)

    def excess(
        self,
        first_frame: int,
        reference: npt.NDArray[np.floating],
        test: npt.NDArray[np.floating],
        frames: UnitFrames | None = None,
        enough: int | None = None,
    ) -> Excess | None:
        """Where the limit does not hold in a block of frames, None where it holds everywhere.

        A face that did not hold is not looked at again.

        Args:
            first_frame: number of the first frame, for the answer.
            reference: (n, V, 3) points of the reference, or (V, 3) of one frame.
            test: (n, W, 3) points of the test mesh, likewise.
            frames: what brings them to unit size; None where they are.
            enough: faces that do not hold after which it may end before all are found; None to find all.
        """
        if reference.ndim == 2:
            reference, test = reference[None], test[None]
        if frames is None:
            frames = UnitFrames(np.zeros((len(reference), 3)), np.ones(len(reference)))
        first, second = (UnitBlock(points, frames, self._device) for points in (reference, test))
        return self.excess_of_blocks(first_frame, first, second, enough=enough)

    def excess_of_blocks(
        self, first_frame: int, reference: UnitBlock, test: UnitBlock, enough: int | None = None
    ) -> Excess | None:
        """The same of frames at unit size."""
        first: int | None = None
        before = [side.failed.copy() for side in self._sides]
        most = np.inf if enough is None else enough
        blocks = reference, test
        # Of a single frame all is known where nothing was known before.
        single = len(reference) == 1 and not any(side.recorded.any() for side in self._sides)
        if any(len(side.unrecorded) for side in self._sides):
            middle = len(reference) // 2
            for index in (0, 1):
                if self._record(index, blocks, middle):
                    first = middle
        if self._new(before) <= most and not single:
            for frame, wanted in self._left(blocks):
                for index, faces in enumerate(wanted):
                    own = self._sides[index]
                    faces = faces[~own.failed[faces]]
                    if not len(faces):
                        continue
                    verdict, _ = self._verdicts(index, blocks, frame, faces, 0, searching=True)
                    own.failed[faces[verdict != WITHIN]] = True
                    if own.failed[faces].any():
                        first = frame if first is None else min(first, frame)
                if self._new(before) > most:
                    break
        if first is None:
            return None
        found = [np.flatnonzero(side.failed & ~old) for side, old in zip(self._sides, before, strict=True)]
        return Excess(first_frame + first, *found)

    def succeeded_by(
        self,
        test_faces: npt.NDArray[np.int32],
        old_face: npt.NDArray[np.int64],
        same: npt.NDArray[np.bool_],
        hint: npt.NDArray[np.int32],
        reference_hint: npt.NDArray[np.int32],
    ) -> DistanceBound:
        """The bound of another test mesh, with what stays true of this one.

        Args:
            test_faces: (M', 3) int.
            old_face: (M',) int, the face of the present test mesh that each one is with the same vertices, -1 for none.
            same: (M',) bool, those of them whose points are the same in every frame.
            hint: (M',) int32, a face of the reference near each of the others.
            reference_hint: (N,) int32, a face of the new test mesh near each face of the reference.
        """
        new = copy.copy(self)
        across = self.reference.surface.across
        new.reference = _Side(self.reference.faces, self._device, reference_hint, across)
        new.test = _Side(test_faces, self._device, hint)
        kept = old_face >= 0
        number = np.full(len(self.test.faces), -1, dtype=np.int32)
        number[old_face[kept]] = np.flatnonzero(kept)
        stays = np.zeros(len(self.test.faces), dtype=bool)
        stays[old_face[kept & same]] = True
        new.reference.inherit(self.reference, np.arange(len(self.reference.faces)), number, stays)
        new.test.inherit(self.test, number, np.arange(len(self.reference.faces)), None)
        new.test.active &= ~(same & new.test.recorded)
        return new

    def look_again(self) -> None:
        """Take nothing as proved, as in frames that have not been seen."""
        for side in self._sides:
            side.active[:], side.failed[:] = True, False

    @property
    def _sides(self) -> tuple[_Side, _Side]:
        return self.reference, self.test

    def _new(self, before: Sequence[npt.NDArray[np.bool_]]) -> int:
        return sum(int((side.failed & ~old).sum()) for side, old in zip(self._sides, before, strict=True))

    def _record(self, index: int, blocks: Sequence[UnitBlock], frame: int) -> bool:
        """Cut the faces without pieces, of one mesh in one frame; whether some do not hold."""
        own, chosen = self._sides[index], self._sides[index].unrecorded
        parts = [own.pieces]
        # Most are near a face that a neighbour leads to; the hierarchy is for the others.
        for searching in (False, True):
            if len(chosen):
                room = PIECES_PER_FACE * len(chosen) + MIN_PIECES
                verdict, found = self._verdicts(index, blocks, frame, chosen, room, searching=searching)
                own.recorded[chosen[verdict == WITHIN]] = True
                parts.append(found.chosen(own.recorded[found.owner]))
                chosen = chosen[(verdict != WITHIN) & (verdict != NO_ROOM)]
        own.pieces = PieceArrays.joined(parts)
        own.failed[chosen] = True
        return len(chosen) > 0

    def _left(self, blocks: Sequence[UnitBlock]) -> list[tuple[int, list[npt.NDArray[np.int64]]]]:
        """The frames in which some faces are not proved by their pieces, and these faces of both sides."""
        frame_count = len(blocks[0])
        left = [np.zeros((frame_count, len(side.faces)), dtype=bool) for side in self._sides]
        for index, own in enumerate(self._sides):
            looked_at = own.active & ~own.failed
            left[index][:, looked_at & ~own.recorded] = True
            keep = looked_at[own.pieces.owner]
            pieces = own.pieces if keep.all() else own.pieces.chosen(keep)
            piece, frame = self._apart(index, blocks, pieces)
            if len(piece):
                beyond = self._piece_verdicts(index, blocks, pieces, piece, frame) != WITHIN
                left[index][frame[beyond], pieces.owner[piece[beyond]]] = True
        return [
            (frame, [np.flatnonzero(faces[frame]) for faces in left])
            for frame in range(frame_count)
            if any(faces[frame].any() for faces in left)
        ]

    def _apart(
        self, index: int, blocks: Sequence[UnitBlock], pieces: PieceArrays
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        """Pieces and frames in which their partners are too far."""
        own, other = self._sides[index], self._sides[1 - index]
        frame_count, count = len(blocks[0]), len(pieces.owner)
        if not count or self._limit <= 2.0 * SINGLE_MARGIN:
            # Single precision does not resolve such distances.
            return np.tile(np.arange(count), frame_count), np.repeat(np.arange(frame_count), count)
        points, others = blocks[index].lanes, blocks[1 - index].lanes
        width = block_width(frame_count, self._device)
        apart = wp.empty((count, points.shape[1]), dtype=wp.int32, device=self._device)
        squared = (self._limit - SINGLE_MARGIN) ** 2

        def check(part: slice) -> None:
            launch(
                check_pieces[width],
                dim=(part.stop - part.start, points.shape[1]),
                inputs=[
                    points,
                    others,
                    own.corner_vertex,
                    other.corner_vertex,
                    pieces.part(part).on_device(self._device),
                    squared,
                ],
                outputs=[apart[part]],
                device=self._device,
            )

        launch_parts(check, count, self._device, MIN_PIECES)
        bits = apart.numpy()
        piece, block = np.nonzero(bits)
        row, lane = np.nonzero((bits[piece, block][:, None] >> np.arange(width)) & 1)
        piece, frame = piece[row], block[row] * width + lane
        inside = frame < frame_count
        return piece[inside], frame[inside]

    def _piece_verdicts(
        self,
        index: int,
        blocks: Sequence[UnitBlock],
        pieces: PieceArrays,
        chosen: npt.NDArray[np.int64],
        frame: npt.NDArray[np.int64],
    ) -> npt.NDArray[np.int32]:
        """Verdicts on some pieces in some frames, from the faces around those that they were near to."""
        own, other, device = self._sides[index], self._sides[1 - index], self._device
        verdict = wp.empty(len(chosen), dtype=wp.int32, device=device)
        given, none = pieces.on_device(device), PieceArrays.none().on_device(device)
        chosen_device, frame_device = (
            wp.array(a.astype(np.int32), dtype=wp.int32, device=device) for a in (chosen, frame)
        )
        used = wp.zeros(1, dtype=wp.int32, device=device)

        def bound(part: slice) -> None:
            launch(
                kernels.bound_pieces,
                dim=part.stop - part.start,
                inputs=[
                    blocks[index].double,
                    blocks[1 - index].double,
                    own.surface,
                    other.surface,
                    self._limit,
                    given,
                    chosen_device[part],
                    frame_device[part],
                    none,
                    used,
                ],
                outputs=[verdict[part]],
                device=device,
            )

        launch_parts(bound, len(chosen), device, MIN_PART)
        return verdict.numpy()

    def _verdicts(
        self,
        index: int,
        blocks: Sequence[UnitBlock],
        frame: int,
        chosen: npt.NDArray[np.int64],
        room: int,
        *,
        searching: bool,
    ) -> tuple[npt.NDArray[np.int32], PieceArrays]:
        """Verdicts on some faces in a frame, and the pieces that they were cut into, as far as there is room."""
        device, own, other = self._device, self._sides[index], self._sides[1 - index]
        own.show(blocks[index], frame, searched=False)
        other.show(blocks[1 - index], frame, searched=searching)
        indices = wp.array(chosen.astype(np.int32), dtype=wp.int32, device=device)
        verdict = wp.empty(len(chosen), dtype=wp.int32, device=device)
        # Each thread has a part of the room of its own.
        parts = split_range(len(chosen), max(1, min(thread_count(device), len(chosen) // MIN_PART)))
        written: list[PieceArrays] = [PieceArrays.none()] * len(parts)

        def bound(number: int, part: slice) -> None:
            size = -(-room // len(parts))
            pieces = kernels.Pieces()
            pieces.owner = wp.empty(size, dtype=wp.int32, device=device)
            pieces.face = wp.empty(size, dtype=wp.int32, device=device)
            pieces.weight = wp.empty((size, 3, 4), dtype=wp.float32, device=device)
            used = wp.zeros(1, dtype=wp.int32, device=device)
            launch(
                kernels.bound_triangles,
                dim=part.stop - part.start,
                inputs=[own.surface, other.surface, self._limit, searching, indices[part], own.hint, used],
                outputs=[pieces, verdict[part]],
                device=device,
            )
            count = min(int(used.numpy()[0]), size)
            arrays = (array.numpy()[:count].copy() for array in (pieces.owner, pieces.face, pieces.weight))
            written[number] = PieceArrays(*arrays)

        run_parts([functools.partial(bound, number, part) for number, part in enumerate(parts)])
        return verdict.numpy(), PieceArrays.joined(written)
