"""A bound on the distance between two meshes in motion that is proved for every point, not read off samples."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.kernels import distance_bound as kernels
from warpqem.measure.bound_side import BoundSide
from warpqem.measure.piece_proof import (
    AROUND,
    FEW_LOOKS,
    MORE_ROOM,
    NO_ROOM,
    SEARCH,
    WALK,
    WITHIN,
    PieceArrays,
    PieceProof,
    count_bits,
    run_writing,
)
from warpqem.measure.unit_frames import UnitBlock, UnitFrames
from warpqem.runtime.launches import launch

__all__ = ["DistanceBound", "Excess", "UnitFrames"]

# Room for pieces, for each triangle: those of a triangle across a vertex of the other mesh are some ten. And for as
# many more.
PIECES_PER_FACE = 12
MORE_PIECES = 4096
# A part of the frames, and at least so many, that are searched, the worst first, before faces are left undecided where
# others do not hold.
SEARCHED_PART = 0.05
# Frames that are searched first: what fails in the worst ones is not looked at in the others.
FIRST_SEARCHED = 3
SEARCHED_FRAMES = 6


@dataclass(frozen=True)
class Excess:
    """Faces that are not within the limit, in some frame; where there are any, others may be left undecided.

    Attributes:
        frame: one of these frames.
        reference_faces: int indices, faces of the reference too far from the test mesh, or not proved to be near.
        test_faces: the same the other way round.
    """

    frame: int
    reference_faces: npt.NDArray[np.int64]
    test_faces: npt.NDArray[np.int64]

    @property
    def face_count(self) -> int:
        """How many they are."""
        return len(self.reference_faces) + len(self.test_faces)


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
        self.reference = BoundSide(reference_faces, device, reference_hint)
        self.test = BoundSide(test_faces, device, test_hint)
        self._unseen = False

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
        own, other = (UnitBlock(points, frames, self._device) for points in (reference, test))
        return self.excess_of_blocks(first_frame, own, other, enough=enough)

    def excess_of_blocks(
        self, first_frame: int, reference: UnitBlock, test: UnitBlock, enough: int | None = None
    ) -> Excess | None:
        """The same of frames at unit size."""
        if self._unseen:
            self._unseen = False
            for side in self._sides:
                side.undecided[:] = ~side.active
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
        for index in (0, 1):
            if self._new(before) <= most and not single:
                beyond = self._check_pieces(index, blocks, before, most)
                first = beyond if first is None else first
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
        new._unseen = False
        across = self.reference.surface.across
        new.reference = BoundSide(self.reference.faces, self._device, reference_hint, across)
        new.test = BoundSide(test_faces, self._device, hint)
        kept = old_face >= 0
        number = np.full(len(self.test.faces), -1, dtype=np.int32)
        number[old_face[kept]] = np.flatnonzero(kept)
        stays = np.zeros(len(self.test.faces), dtype=bool)
        stays[old_face[kept & same]] = True
        new.reference.inherit(self.reference, np.arange(len(self.reference.faces)), number, stays)
        new.test.inherit(self.test, number, np.arange(len(self.reference.faces)), None)
        new.test.active |= ~same
        return new

    def look_again(self) -> None:
        """Take nothing as proved, as in frames that have not been seen."""
        for side in self._sides:
            side.active[:], side.failed[:], side.undecided[:] = True, False, True
        self._unseen = True

    @property
    def _sides(self) -> tuple[BoundSide, BoundSide]:
        return self.reference, self.test

    def _new(self, before: Sequence[npt.NDArray[np.bool_]]) -> int:
        return sum(int((side.failed & ~old).sum()) for side, old in zip(self._sides, before, strict=True))

    def _record(self, index: int, blocks: Sequence[UnitBlock], frame: int) -> bool:
        """Cut the faces without pieces, of one mesh in one frame; whether some do not hold."""
        own, chosen = self._sides[index], self._sides[index].unrecorded
        parts = [own.pieces]
        # Most are near a face that a neighbour leads to; the hierarchy is for the others.
        for effort in (WALK, AROUND, SEARCH):
            if len(chosen):
                verdict, found = self._verdicts(index, blocks, frame, chosen, effort)
                own.recorded[chosen[verdict == WITHIN]] = True
                parts.append(found.chosen(own.recorded[found.owner]))
                chosen = chosen[verdict != WITHIN]
        own.pieces = PieceArrays.joined(parts)
        own.failed[chosen] = True
        return len(chosen) > 0

    def _check_pieces(
        self,
        index: int,
        blocks: Sequence[UnitBlock],
        before: Sequence[npt.NDArray[np.bool_]],
        most: float,
    ) -> int | None:
        """Look at the pieces of one mesh in all frames; a frame in which a face does not hold, None for none."""
        own, other = self._sides[index], self._sides[1 - index]
        looked_at = own.active & ~own.failed
        pieces = own.pieces.chosen(looked_at[own.pieces.owner])
        proof = PieceProof(own, other, blocks[index], blocks[1 - index], self._limit, self._device)
        rows, left = proof.apart_somewhere(pieces)
        pieces, found, searched = pieces.chosen(rows), None, 0
        first = FIRST_SEARCHED if count_bits(left) > FEW_LOOKS else 0
        while left.any() and self._new(before) <= most:
            if searched == first:
                rows, left = proof.unproved(pieces, left)
                pieces = pieces.chosen(rows)
                if not len(rows):
                    break
            if searched >= max(SEARCHED_FRAMES, SEARCHED_PART * len(blocks[0])) and self._new(before):
                own.undecided[pieces.owner] = True
                break
            searched += 1
            frame = proof.most_common(left)
            other.show(blocks[1 - index], frame, searched=True)
            beyond, left = proof.search(pieces, left, frame)
            if beyond.any():
                found = frame if found is None else found
                own.failed[pieces.owner[beyond]] = True
            keep = left.any(axis=1) & ~own.failed[pieces.owner]
            pieces, left = pieces.chosen(keep), left[keep]
        if index == 0:
            own.rely_on(proof.relied_on)
        return found

    def _verdicts(
        self,
        index: int,
        blocks: Sequence[UnitBlock],
        frame: int,
        chosen: npt.NDArray[np.int64],
        effort: int,
    ) -> tuple[npt.NDArray[np.int32], PieceArrays]:
        """Verdicts on some faces in a frame, and the pieces that they were cut into."""
        device, own, other = self._device, self._sides[index], self._sides[1 - index]
        own.show(blocks[index], frame, searched=False)
        other.show(blocks[1 - index], frame, searched=effort == SEARCH)
        indices = wp.array(chosen.astype(np.int32), dtype=wp.int32, device=device)
        verdict, hint = wp.empty(len(chosen), dtype=wp.int32, device=device), wp.clone(own.hint)

        def bound(part: slice, used: wp.array, pieces: kernels.Pieces) -> None:
            launch(
                kernels.bound_triangles,
                dim=part.stop - part.start,
                inputs=[own.surface, other.surface, self._limit, effort, indices, part.start, own.hint, used],
                outputs=[pieces, verdict],
                device=device,
            )

        room = PIECES_PER_FACE * len(chosen) + MORE_PIECES
        while True:
            written = run_writing(bound, len(chosen), room, device)
            verdicts: npt.NDArray[np.int32] = verdict.numpy()
            if not (verdicts == NO_ROOM).any():
                return verdicts, written
            # Again as it was, so that the pieces do not depend on the room that each thread had.
            wp.copy(own.hint, hint)
            room *= MORE_ROOM
