"""Mean sizes of the faces of an output over the key frames, and what pairs and edges weigh by them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from warpqem.frames.device_frames import to_device
from warpqem.kernels import refit as kernels
from warpqem.runtime import new_arrays
from warpqem.runtime.device import device_traits
from warpqem.runtime.launches import launch

__all__ = ["OUTPUT_SHARE", "FitSizes", "Scales", "frame_scale", "seam_share"]

# They hardly change from frame to frame: about so many frames suffice.
FRAMES = 8
# Sums that a device with its own memory hands to the host, each by a thread.
SUMS = 1024
# Distances from the output to the input count twice: without that the input's many samples in sharp places draw the
# output inwards there.
OUTPUT_SHARE = 2.0
# Stiffness on the relative change of edge lengths. Twice as much fits 0.6 % worse and changes edges 2 % less.
EDGE_STIFFNESS = 0.002
# A border counts as a strip beside it, so wide in mean edge lengths of the output.
BORDER_WIDTH = 0.5
# What a length of seam counts of what a border of that length does, along the surface. With 0.8 a walking man has 2 %
# more of the distance, and next to no less of the texture error.
SEAM_SHARE = 0.6
# Seams of more edges than this part of the output's faces count together as that many: of a mesh of islands of a few
# faces each they would take the place of the surface.
MAX_SEAMS = 0.35
# A frame is taken for no smaller than this part of the largest one: distances in one that is next to a point say
# nothing of how the others look.
SMALLEST_FRAME = 0.1


@dataclass(frozen=True)
class Scales:
    """Mean sizes over the key frames, in diagonals."""

    area: float
    edge_squared: float

    @classmethod
    def of(cls, points: np.ndarray, faces: np.ndarray) -> Scales:
        """Those of faces (N', 3) in some frames (n, C, 3)."""
        corner = points[:, faces]
        edge = np.roll(corner, -1, axis=2) - corner
        area = 0.5 * np.linalg.norm(np.cross(edge[:, :, 0], edge[:, :, 1]), axis=2).sum(axis=1)
        return cls(float(area.mean()), float((edge.astype(np.float64) ** 2).sum(axis=-1).mean()))


def seam_share(seam_edges: int, face_count: int) -> float:
    """What a length of seam counts of what a border does on an output of so many edges of seams and faces."""
    most = MAX_SEAMS * face_count
    return SEAM_SHARE * (most / seam_edges if seam_edges > most else 1.0)


@dataclass(frozen=True)
class FitSizes:
    """What the sizes of an output come to in its fit, on the device.

    Attributes:
        values: (SIZES,) float32, see :mod:`warpqem.kernels.refit`.
        has_area: (1,) int32, 0 where all faces are lines or points: there nothing is to be fitted.
        is_flat: whether the host knows so.
    """

    values: wp.array
    has_area: wp.array
    is_flat: bool

    @classmethod
    def of(
        cls,
        points: np.ndarray | wp.array,
        faces: np.ndarray,
        corner_vertex: wp.array,
        vertex_count: int,
        turns: int,
        seam_edges: int,
    ) -> FitSizes:
        """Those of an output in its key frames.

        Args:
            points: (K, C, 3) float32, or (K, C) points on the device.
            faces: (N', 3) int32.
            corner_vertex: (3N',) int32, the same on the device.
            vertex_count: output vertices C.
            turns: frames that each sample is paired in.
            seam_edges: its edges on seams.
        """
        share = seam_share(seam_edges, len(faces))
        edge_weight = EDGE_STIFFNESS / 6.0 / len(points)
        some, device = points[:: max(1, len(points) // FRAMES)], corner_vertex.device
        if device_traits(str(device)).own_memory:
            # Wherever the frames are: results are the same.
            there = to_device(np.ascontiguousarray(some), str(device)) if isinstance(some, np.ndarray) else some
            return cls._measured_there(there, corner_vertex, vertex_count, turns, edge_weight, share)
        scales = Scales.of(some if isinstance(some, np.ndarray) else some.contiguous().numpy(), faces)
        is_flat = not scales.area > 0.0
        # One for a vertex's share of the area.
        unit = 0.0 if is_flat else vertex_count / (scales.area * turns)
        width = BORDER_WIDTH * scales.edge_squared**0.5
        mass = (1.0 + OUTPUT_SHARE) * turns * unit
        values = [scales.edge_squared, unit, OUTPUT_SHARE * unit, edge_weight, mass, width, share * width]
        return cls(
            new_arrays.uploaded(values, dtype=wp.float32, device=device),
            new_arrays.uploaded([int(not is_flat)], dtype=wp.int32, device=device),
            is_flat,
        )

    @classmethod
    def _measured_there(
        cls, points: wp.array, corner_vertex: wp.array, vertex_count: int, turns: int, edge_weight: float, share: float
    ) -> FitSizes:
        """The same by kernels: the host waits for nothing."""
        device, face_count = corner_vertex.device, len(corner_vertex) // 3
        sums = new_arrays.empty((min(SUMS, face_count), 2), dtype=wp.float64, device=device)
        launch(kernels.sum_face_sizes, len(sums), [points, corner_vertex], [sums], device=device)
        shares = kernels.SizeShares()
        shares.vertex_count, shares.turns, shares.output_share = vertex_count, turns, OUTPUT_SHARE
        shares.edge_weight, shares.border_width, shares.seam_width = (
            edge_weight,
            BORDER_WIDTH,
            share * BORDER_WIDTH,
        )
        values = new_arrays.empty(int(kernels.SIZES), dtype=wp.float32, device=device)
        has_area = new_arrays.empty(1, dtype=wp.int32, device=device)
        inputs = [sums, float(len(points)), float(3 * face_count), shares]
        launch(kernels.weigh_sizes, 1, inputs, [values, has_area], device=device)
        return cls(values, has_area, False)


def frame_scale(points: np.ndarray) -> np.ndarray:
    """(K,) float32, by how much the frames of points (K, n, 3) are smaller than the largest one, by their diagonals.

    Distances of measures are in the diagonal of their frame: a figure that crouches may be half as large.
    """
    diagonal = np.linalg.norm(np.ptp(points, axis=1), axis=1)
    largest = diagonal.max(initial=0.0)
    if not largest > 0.0:
        return np.ones(len(points), dtype=np.float32)
    scale: np.ndarray = (largest / np.maximum(diagonal, SMALLEST_FRAME * largest)).astype(np.float32)
    return scale
