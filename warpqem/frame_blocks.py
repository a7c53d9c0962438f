"""Frames in blocks on the device: how the kernels see positions (see :mod:`warpqem.kernels.lanes`)."""

from __future__ import annotations

from functools import partial

import numpy as np
import warp as wp

from warpqem.kernels import lanes as kernels
from warpqem.parallel import run_parts, split_range, thread_count

__all__ = ["block_width", "pack_frames", "unpack_frames"]


def block_width(frame_count: int, device: str) -> int:
    """Frames in a block: as wide as a CPU's vector registers, but one on a GPU and for a single frame."""
    return kernels.WIDE if frame_count > 1 and wp.get_device(device).is_cpu else 1


def pack_frames(
    points: np.ndarray, device: str, *, centre: np.ndarray | tuple[float, float, float] = (0, 0, 0), scale: float = 1
) -> wp.array:
    """Blocks (V, B) of ``(points - centre) scale``; the frames that fill up the last block are zero.

    Args:
        points: (F, V, 3) float32, C-contiguous.
        device: Warp device.
        centre: taken off every point.
        scale: multiplies what is left.
    """
    frame_count, vertex_count = points.shape[:2]
    width = block_width(frame_count, device)
    source = wp.array(points, dtype=wp.vec3, device=device, copy=False)
    blocks = wp.empty((vertex_count, -(-frame_count // width)), dtype=kernels.POINTS[width], device=device)

    def pack(part: slice) -> None:
        wp.launch(
            kernels.pack_frames,
            dim=(part.stop - part.start, blocks.shape[1]),
            inputs=[source[:, part], wp.vec3(*map(float, centre)), float(scale)],
            outputs=[blocks[part]],
            device=device,
        )

    run_parts([partial(pack, part) for part in split_range(vertex_count, thread_count(device))])
    return blocks


def unpack_frames(blocks: wp.array, frame_count: int) -> np.ndarray:
    """(F, V, 3) float32 of blocks (V, B) of points."""
    points = wp.empty((frame_count, len(blocks)), dtype=wp.vec3, device=blocks.device)
    wp.launch(kernels.unpack_frames, dim=blocks.shape, inputs=[blocks], outputs=[points], device=blocks.device)
    return points.numpy()
