"""Frames of a level on their way to a sink, bounded as they come, as they are placed or refitted.

A refit moves what it may within the limit, and what it would take too far stays as it was placed. The surface as placed
is proved to be within the limit before. A vertex that is held stays there, and no other moves for it, so that what lies
over faces of held vertices is as near as it was: at the worst, all of them are held.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from warpqem.frames.device_frames import to_device
from warpqem.frames.stream import FrameSink
from warpqem.measure.bound import DistanceBound, Excess
from warpqem.measure.unit_frames import ChangingBlock
from warpqem.pipeline.bound_sink import LimitFrames
from warpqem.pipeline.cut_levels import CutLevel
from warpqem.runtime import new_arrays
from warpqem.runtime.device import device_turn

__all__ = ["BoundedFrames", "HeldVertices", "SettledFrames"]


class BoundedFrames:
    """Bounds the frames of a level as they come, keeps where they are too far, and passes them on.

    Args:
        sink: takes the frames.
        frames: those of the input.
        bound: bounds them.
        level: the level.
        device: Warp device.
        proved: (F, C, 3) frames that have been bounded: those that come with the same bits are not bounded again.

    Attributes:
        excess: where frames are too far.
        differs: whether frames came that are not those that were proved.
    """

    def __init__(
        self,
        sink: FrameSink,
        frames: LimitFrames,
        bound: DistanceBound,
        level: CutLevel,
        device: str,
        proved: np.ndarray | None = None,
    ) -> None:
        self._sink, self._frames, self._bound, self._device = sink, frames, bound, device
        self._level, self._proved, self.differs = level, proved, False
        self.excess: list[Excess] = []

    def begin(self, frame_count: int, vertex_count: int, faces: np.ndarray) -> None:
        """Pass it on."""
        self.excess = []
        self._sink.begin(frame_count, vertex_count, faces)

    def write(self, frames: slice, points: np.ndarray) -> None:
        """Bound consecutive frames."""
        self._sink.write(frames, points)
        if self._proved is not None:
            self.differs |= not np.array_equal(self._proved[frames], points)
            return
        with device_turn(self._device):
            units, reference = self._frames.block(frames)
            test = ChangingBlock((len(points), reference.vertex_count), units, self._device)
            kept = new_arrays.uploaded(self._level.kept, dtype=wp.int32, device=self._device)
            test.put(kept, to_device(points, self._device))
            found = self._bound.excess_of_blocks(frames.start, reference, test)
        if found is not None:
            self.excess.append(found)


class HeldVertices:
    """The vertices of a level that its refit left as placed when it was settled; they are held from the beginning.

    Attributes:
        held: (C,) bool.
    """

    def __init__(self, level: CutLevel) -> None:
        held = level.choice.held
        self.held = np.zeros(len(level.kept), dtype=bool) if held is None else held[level.kept]

    def is_settled(self) -> bool:
        """It was settled before."""
        return True


class SettledFrames(BoundedFrames, HeldVertices):
    """Bounds refitted frames, and holds the vertices that take them too far; arguments as before.

    Args:
        near: (N,) int32, a face of the level near each face of the input.

    Attributes:
        held: (C,) bool, vertices that stay as placed.
        excess: what is too far although it is as placed; empty where all is within the limit.
    """

    def __init__(
        self,
        sink: FrameSink,
        frames: LimitFrames,
        bound: DistanceBound,
        level: CutLevel,
        device: str,
        near: np.ndarray,
    ) -> None:
        BoundedFrames.__init__(self, sink, frames, bound, level, device)
        HeldVertices.__init__(self, level)
        # What proved the level as it is placed.
        self._placed, self._near = bound, near
        index = np.full(len(level.is_kept), -1, dtype=np.int64)
        index[level.kept] = np.arange(len(level.kept))
        # The vertex that each one of the input went to, and those of faces.
        self._vertex, self._faces = index[level.ordered.root], index[level.ordered.faces]
        self._bound = self._succeeding(bound, np.zeros(len(self._faces), dtype=bool))

    def is_settled(self) -> bool:
        """Whether all is within the limit, or nothing more can be held."""
        more = np.zeros(len(self.held), dtype=bool)
        for excess in self.excess:
            more[self._vertices_of(excess)] = True
        more &= ~self.held
        if not more.any():
            return True
        self.held = self.held | more
        with device_turn(self._device):
            self._bound = self._succeeding(self._bound, ~more[self._faces].any(axis=1))
        return False

    def choice_held(self) -> np.ndarray:
        """(V,) bool, the vertices held, by the input vertices that they go by."""
        held = np.zeros(len(self._level.is_kept), dtype=bool)
        held[self._level.kept[self.held]] = True
        return held

    def _vertices_of(self, excess: Excess) -> np.ndarray:
        """The vertices of faces that are too far, and those that faces of the input lay over as they were placed."""
        side = self._placed.reference
        is_far = np.zeros(len(side.faces), dtype=bool)
        is_far[excess.reference_faces] = True
        under = side.pieces.face[is_far[side.pieces.owner]]
        relied_on = side.relied_on[is_far[side.relied_on[:, 0]], 1]
        faces = self._faces[np.concatenate([excess.test_faces, under, relied_on])]
        vertices = np.concatenate([faces.ravel(), self._vertex[side.faces[excess.reference_faces]].ravel()])
        return np.unique(vertices[vertices >= 0])

    def _succeeding(self, bound: DistanceBound, same: np.ndarray) -> DistanceBound:
        """The bound of the level once more, of which some faces (M,) are where they were."""
        ordered = self._level.ordered
        every = np.arange(len(ordered.faces))
        return bound.succeeded_by(ordered.faces, every, same, ordered.face_map, self._near)
