"""The input in its key frames, as a refit compares the output with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from warpqem.frames.blocks import unpack_frames
from warpqem.frames.device_frames import BoundsMeter
from warpqem.kernels.frame_bounds import compare_frames
from warpqem.mesh.mesh_input import AnimatedMesh
from warpqem.refit.scales import SMALLEST_FRAME, frame_scale
from warpqem.runtime import new_arrays
from warpqem.runtime.device import device_traits
from warpqem.runtime.launches import launch

__all__ = ["Reference"]


@dataclass(frozen=True)
class Reference:
    """Key frames of the input on the device.

    Attributes:
        points: (K, V) vec3, in diagonals about the mesh's centre.
        frame_scale: (K,) float32, see :func:`warpqem.refit.scales.frame_scale`.
    """

    points: wp.array
    frame_scale: wp.array

    @classmethod
    def of(cls, mesh: AnimatedMesh, key_frames: np.ndarray, device: str) -> Reference:
        """Those of a mesh; where it is on the device already they are taken from there."""
        if not device_traits(device).own_memory:
            unit = mesh.to_unit(mesh.chosen_points(key_frames))
            return cls(
                new_arrays.uploaded(unit, dtype=wp.vec3, device=device),
                new_arrays.uploaded(frame_scale(unit[:, mesh.used]), dtype=wp.float32, device=device),
            )
        points = wp.empty((len(key_frames), mesh.vertex_count), dtype=wp.vec3, device=device)
        unpack_frames(mesh.unit_blocks(key_frames, device), points)
        bounds = BoundsMeter(mesh.used, device).bounds_there(points)
        scale = new_arrays.empty(len(key_frames), dtype=wp.float32, device=device)
        launch(compare_frames, 1, [bounds, SMALLEST_FRAME], [scale], device=device)
        return cls(points, scale)
