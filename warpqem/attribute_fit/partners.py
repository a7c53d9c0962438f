"""Partners of samples: for points of every output face the nearest points of the input, on their own side of seams."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.attribute_fit.cut_surface import cut_surface
from warpqem.decimation.adjacency import build_adjacency
from warpqem.kernels import attribute_fit as kernels
from warpqem.pipeline.result import SimplifiedMesh
from warpqem.pipeline.surface_transfer import SurfaceTransfer
from warpqem.refit.matching import OUTPUT_SAMPLES, make_surface
from warpqem.runtime.device import on_device
from warpqem.runtime.part_launches import FIRST_ITEM, launch_in_parts

__all__ = ["SAMPLES", "Partners", "find_partners"]

Floats = npt.NDArray[np.float64]

# Weights (S, 3) of the corners at the samples of a face, all of one weight in the sums.
SAMPLES = OUTPUT_SAMPLES


@dataclass(frozen=True)
class Partners:
    """Points of the input for the S samples of each of N' output faces, on the device.

    Attributes:
        face: (N', S) int32, face of the input; -1 for none.
        weight: (N', S) vec3, weights of its corners.
        area: (N',) float64, areas of the output faces in the reference pose, parts of the largest.
        device: Warp device.
    """

    face: wp.array
    weight: wp.array
    area: Floats
    device: str


@on_device
def find_partners(
    points: npt.NDArray[np.floating],
    faces: npt.NDArray[np.int32],
    result: SimplifiedMesh,
    transfer: SurfaceTransfer,
    seams: npt.NDArray[np.int64],
    placed: npt.NDArray[np.floating],
    *,
    device: str,
) -> Partners:
    """Find them in one pose, downhill from where the corners of the output get their values.

    Args:
        points: (V, 3), the input's pose.
        faces: (N, 3) int32, its faces.
        result: the simplified mesh.
        transfer: where its corners get their values from.
        seams: (S, 2) int64, the seams of that.
        placed: (V', 3), the output in that pose.
        device: Warp device.
    """
    pose, placed = points.astype(np.float64), placed.astype(np.float64)
    # About the pose's middle, and parts of its size, so that single precision does.
    low, high = pose.min(axis=0), pose.max(axis=0)
    middle, size = (low + high) / 2, float(np.linalg.norm(high - low)) or 1.0
    pose, placed = (pose - middle) / size, (placed - middle) / size
    cut = cut_surface(faces, seams, None if result.repair is None else result.repair.sheets)
    used = cut.face
    corner_vertex = wp.array(cut.corner[used].ravel(), dtype=wp.int32, device=device)
    surface = make_surface(
        wp.array(pose[cut.vertex][None], dtype=wp.vec3, device=device),
        corner_vertex,
        build_adjacency(corner_vertex, len(cut.vertex)),
    )
    # The heaviest corner of the face that each corner of the output lies on.
    nearest = np.take_along_axis(cut.corner[transfer.wedge_face], transfer.wedge_weight.argmax(axis=1)[:, None], axis=1)
    shape = (len(result.faces), len(SAMPLES))
    partner = wp.empty(shape, dtype=wp.int32, device=device)
    weight = wp.zeros(shape, dtype=wp.vec3, device=device)
    launch_in_parts(
        kernels.find_partners,
        shape,
        [
            FIRST_ITEM,
            surface,
            wp.array(nearest[:, 0][transfer.corner_wedge].ravel(), dtype=wp.int32, device=device),
            wp.array(result.faces.ravel(), dtype=wp.int32, device=device),
            wp.array(placed, dtype=wp.vec3, device=device),
            wp.array(SAMPLES, dtype=wp.vec3, device=device),
        ],
        [partner, weight],
        device=device,
    )
    found = partner.numpy()
    partner.assign(np.where(found >= 0, used[found], -1).astype(np.int32))
    corner = placed[result.faces]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    return Partners(partner, weight, area / (area.max(initial=0.0) or 1.0), device)
