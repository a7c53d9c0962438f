"""Frames in blocks on the device: how the kernels see positions (see :mod:`warpqem.kernels.lanes`)."""

from __future__ import annotations

import numpy as np
import warp as wp

from warpqem.kernels import lanes as kernels
from warpqem.parallel import launch_parts

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
    kernel = kernels.pack_frames[width]
    source = wp.array(points, dtype=wp.vec3, device=device, copy=False)
    blocks = wp.empty((vertex_count, -(-frame_count // width)), dtype=kernels.POINTS[width], device=device)

    def pack(part: slice) -> None:
        wp.launch(
            kernel,
            dim=(part.stop - part.start, blocks.shape[1]),
            inputs=[source[:, part], wp.vec3(*map(float, centre)), float(scale)],
            outputs=[blocks[part]],
            device=device,
        )

    launch_parts(kernel, pack, vertex_count, device)
    return blocks


def unpack_frames(blocks: wp.array, frame_count: int) -> np.ndarray:
    """(F, V, 3) float32 of blocks (V, B) of points."""
    points = wp.empty((frame_count, len(blocks)), dtype=wp.vec3, device=blocks.device)
    unpack = kernels.unpack_frames[kernels.width_of(blocks)]
    wp.launch(unpack, dim=blocks.shape, inputs=[blocks], outputs=[points], device=blocks.device)
    return points.numpy()
