"""Frames in blocks on the device: how the kernels see positions (see :mod:`warpqem.kernels.lanes`)."""

from __future__ import annotations

import numpy as np
import warp as wp

from warpqem.kernels import lanes as kernels
from warpqem.runtime import new_arrays
from warpqem.runtime.device import device_traits
from warpqem.runtime.part_launches import FIRST_ITEM, launch_in_parts

__all__ = ["block_width", "chunk_frames", "chunk_steps", "frame_blocks", "pack_frames", "unpack_frames"]

# Frames are worked on in blocks of so many bytes of input: ten milliseconds of work on a CPU core, so that starting it
# costs nothing to speak of, and small beside what a program takes anyway. Larger blocks are no faster.
BLOCK_BYTES = 8 * 2**20
# Frames that a GPU thread sums for the deformation term: a moved vertex then has F / 32 threads, and the sums take a
# fifth of the memory that the trajectories do.
CHUNK_FRAMES = 32
# Steps that a GPU thread takes at least: each chunk sees one frame more than it has steps, here a quarter more.
MIN_STEPS = 4


def frame_blocks(frame_count: int, vertex_count: int, block_frames: int | None = None) -> list[slice]:
    """Consecutive blocks of frames, of ``block_frames`` each or of bounded size, in whole vector registers."""
    size = max(1, BLOCK_BYTES // (12 * vertex_count)) if block_frames is None else block_frames
    size = max(kernels.WIDE, size - size % kernels.WIDE)
    return [slice(first, min(first + size, frame_count)) for first in range(0, frame_count, size)]


def block_width(frame_count: int, device: str) -> int:
    """Frames in a block: as wide as a CPU's vector registers, but one on a GPU and for a single frame."""
    return device_traits(device).block_width if frame_count > 1 else 1


def chunk_frames(frame_count: int, device: str) -> int:
    """Frames that one thread sums for the deformation term: all of them on a CPU, which has no thread to spare."""
    return max(1, frame_count) if device_traits(device).in_order else CHUNK_FRAMES


def chunk_steps(step_count: int, item_count: int, device: str) -> int:
    """Steps between frames that one thread takes for one of so many items, where a maximum over all is wanted.

    All of them on a CPU, and on a GPU that has an item for every thread; else as many as give each thread its share.
    """
    traits = device_traits(device)
    if traits.in_order:
        return max(1, step_count)
    return min(max(MIN_STEPS, -(-step_count * item_count // traits.launch_threads)), max(1, step_count))


def pack_frames(
    points: np.ndarray | wp.array,
    device: str,
    *,
    frames: np.ndarray | None = None,
    centre: np.ndarray | tuple[float, float, float] = (0, 0, 0),
    scale: float = 1,
    width: int | None = None,
) -> wp.array:
    """Blocks (V, B) of ``(points - centre) scale``; the frames that fill up the last block are zero.

    Args:
        points: (F, V, 3) float32, C-contiguous, or (F, V) points on the device.
        device: Warp device.
        frames: (K,) int, the frames to pack; None for all.
        centre: taken off every point.
        scale: multiplies what is left.
        width: frames in a block; None for what suits so many frames.
    """
    source = points
    if isinstance(points, np.ndarray):
        source = new_arrays.uploaded(points, dtype=wp.vec3, device=device, copy=False)
    vertex_count = source.shape[1]
    # An empty list stands for all frames.
    rows = new_arrays.uploaded(() if frames is None else frames, dtype=wp.int32, device=device)
    frame_count = len(source) if frames is None else len(rows)
    width = block_width(frame_count, device) if width is None else width
    blocks = new_arrays.empty((vertex_count, -(-frame_count // width)), dtype=kernels.POINTS[width], device=device)
    inputs = [source, rows, wp.vec3(*map(float, centre)), float(scale), FIRST_ITEM]
    launch_in_parts(kernels.pack_frames[width], _tiles(blocks), inputs, [blocks], device=device)
    return blocks


def unpack_frames(blocks: wp.array, points: wp.array) -> None:
    """Bring blocks (V, B) of points into ``points`` (F, V) on the same device."""
    unpack = kernels.unpack_frames[kernels.width_of(blocks)]
    launch_in_parts(unpack, _tiles(blocks), [blocks, FIRST_ITEM], [points], device=blocks.device)


def _tiles(blocks: wp.array) -> tuple[int, int, int]:
    """Tiles of vertices, blocks of frames, and the vertices of a tile."""
    vertex_count, block_count = blocks.shape
    return -(-vertex_count // kernels.TILE_VERTICES), block_count, kernels.TILE_VERTICES
