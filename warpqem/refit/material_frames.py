"""Placed frames on the device with the material frame of every vertex, in which corrections move them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp

from warpqem.frames.device_frames import to_device
from warpqem.frames.stream import read_ahead
from warpqem.kernels import material_frame as kernels
from warpqem.place.block_placer import PlacedFrames
from warpqem.place.frame_store import AnyFrameStore
from warpqem.runtime import new_arrays
from warpqem.runtime.part_launches import launch_in_parts, rows_of

__all__ = ["FRAME_BYTES", "MaterialBlock", "MaterialFrames"]

# A vertex in a frame: point, normal, material frame.
FRAME_BYTES = 12 + 12 + 36


@dataclass(frozen=True)
class MaterialBlock:
    """Some frames.

    Attributes:
        points: (n, C) vec3, as placed.
        normals: (n, C) vec3, of any length.
        frames: (n, C) mat33, see :func:`warpqem.kernels.material_frame.material_frame`; zero for vertices that stay.
    """

    points: wp.array
    normals: wp.array
    frames: wp.array

    def moved(self, correction: wp.array) -> wp.array:
        """The points (n, C) with each vertex moved by its correction (C,) vec3, the same in all frames."""
        moved = new_arrays.empty(self.points.shape, dtype=wp.vec3, device=str(self.points.device))
        self.move(correction, moved)
        return moved

    def move(self, correction: wp.array, moved: wp.array) -> None:
        """The same into an array that is there."""
        launch_in_parts(
            kernels.move_by_corrections,
            self.points.shape,
            [rows_of(self.points), rows_of(self.frames), correction],
            [rows_of(moved)],
            device=str(moved.device),
        )

    def mark_new_flips(self, correction: wp.array, corner_vertex: wp.array, marks: wp.array) -> None:
        """Set ``marks`` (C,) int32 to 1 at moved vertices of faces that turn over by a correction in some frame."""
        launch_in_parts(
            kernels.mark_new_flips,
            (len(self.points), len(corner_vertex) // 3),
            [*map(rows_of, (self.points, self.moved(correction), self.normals)), correction, corner_vertex],
            [marks],
            device=str(marks.device),
        )


class MaterialFrames:
    """The frames of a mesh, kept on the device where they are one block: a fit looks through them some ten times.

    Args:
        rings: the faces about its vertices, and the pose that material frames start from.
        free: (C,) bool, vertices that may move.
        placed: all frames.
        blocks: frames to look at at once.
        device: Warp device.

    Attributes:
        is_kept: whether they are kept.
    """

    def __init__(
        self, rings: kernels.OneRings, free: np.ndarray, placed: AnyFrameStore, blocks: Sequence[slice], device: str
    ) -> None:
        self._rings, self._placed, self._blocks, self._device = rings, placed, blocks, device
        self._free = new_arrays.uploaded(free, dtype=wp.int32, device=device)
        self.is_kept = len(blocks) == 1
        self._kept: list[MaterialBlock] = []

    def of(self, placed: PlacedFrames) -> MaterialBlock:
        """Some frames."""
        points, normals = to_device(placed.points, self._device), to_device(placed.normals, self._device)
        frames = new_arrays.empty(points.shape, dtype=wp.mat33, device=self._device)
        launch_in_parts(
            kernels.measure_material_frames,
            points.shape,
            [self._rings, rows_of(points), rows_of(normals), self._free],
            [rows_of(frames)],
            device=self._device,
        )
        return MaterialBlock(points, normals, frames)

    def of_block(self, placed: PlacedFrames) -> MaterialBlock:
        """One of the blocks that frames are looked at in; where it is the only one, as it was kept."""
        return self._kept[0] if self._kept else self.of(placed)

    def all(self) -> Iterator[MaterialBlock]:
        """All frames, block by block."""
        if self._kept:
            yield from self._kept
            return
        kept = []
        for _, placed in read_ahead(self._placed.read, self._blocks):
            block = self.of(placed)
            if self.is_kept:
                kept.append(block)
            yield block
        self._kept = kept
