"""Partners of samples: for points of every output face the nearest points of the input, on their own side of seams."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.attribute_fit.cut_surface import cut_surface
from warpqem.decimation.adjacency import build_adjacency
from warpqem.kernels import attribute_fit as kernels
from warpqem.pipeline.result import SimplifiedMesh
from warpqem.pipeline.surface_transfer import SurfaceTransfer
from warpqem.refit.matching import make_surface
from warpqem.runtime import new_arrays
from warpqem.runtime.device import device_turn
from warpqem.runtime.part_launches import FIRST_ITEM, launch_in_parts

__all__ = ["FEW_FACES", "SAMPLES", "SAMPLES_OF_FEW", "PartnerSearch", "Partners"]

Floats = npt.NDArray[np.float64]

# Weights (S, 3) of the corners at the samples of a face, all of one weight in the sums: the points of the rule of
# degree 2 (Strang and Fix 1973), by which sums of squares of linear functions are exact. More of them, nearer to edges,
# meet what lies beyond an edge that went, and draw the values there: with twelve the normals of CesiumMan at 25 % were
# off by 2.5 degrees instead of 1.9.
SAMPLES = np.full((3, 3), 1.0 / 6.0) + 0.5 * np.eye(3)


def _quartered(rule: Floats) -> Floats:
    """A rule on the four triangles between the corners and the middles of the edges."""
    corners = np.eye(3)
    middles = (corners + np.roll(corners, -1, axis=0)) / 2
    parts = [np.stack([corners[k], middles[k], middles[k - 1]]) for k in range(3)]
    return np.concatenate([rule @ part for part in [*parts, middles]])


# One of a few faces stands for many parts of the input, which three points miss: there are four times as many on each.
FEW_FACES, SAMPLES_OF_FEW = 100, _quartered(SAMPLES)


@dataclass(frozen=True)
class Partners:
    """Points of the input for the S samples of each of N' output faces, on the device.

    Attributes:
        face: (N', S) int32, face of the input; -1 for none.
        weight: (N', S) vec3, weights of its corners.
        area: (N',) float64, areas of the output faces in the reference pose, parts of the largest.
        samples: (S, 3) float64, weights of the corners of the output at the samples, in each pose the same ones.
        device: Warp device.
    """

    face: wp.array
    weight: wp.array
    area: Floats
    samples: Floats
    device: str

    @cached_property
    def face_on_host(self) -> npt.NDArray[np.int32]:
        """``face``, read from the device once."""
        found: npt.NDArray[np.int32] = self.face.numpy()
        return found

    @cached_property
    def weight_on_host(self) -> npt.NDArray[np.float32]:
        """``weight`` (N', S, 3), likewise."""
        found: npt.NDArray[np.float32] = self.weight.numpy()
        return found

    @cached_property
    def area_on_device(self) -> wp.array:
        """``area``, uploaded once for all fits."""
        return new_arrays.uploaded(self.area, dtype=wp.float64, device=self.device)

    @cached_property
    def samples_on_device(self) -> wp.array:
        """``samples`` (S,) vec3, likewise."""
        return new_arrays.uploaded(self.samples, dtype=wp.vec3, device=self.device)

    @classmethod
    def over_poses(cls, poses: Sequence[Partners]) -> Partners:
        """Partners in several poses as more samples of each face; areas are those of the first."""
        first = poses[0]
        if len(poses) == 1:
            return first
        face = np.concatenate([one.face_on_host for one in poses], axis=1)
        weight = np.concatenate([one.weight_on_host for one in poses], axis=1)
        with device_turn(first.device):
            on_device = (
                new_arrays.uploaded(face, dtype=wp.int32, device=first.device),
                new_arrays.uploaded(weight, dtype=wp.vec3, device=first.device),
            )
        return cls(*on_device, first.area, np.tile(first.samples, (len(poses), 1)), first.device)


class PartnerSearch:
    """Finds partners in poses of both meshes.

    Args:
        faces: (N, 3) int32, those of the input.
        result: the simplified mesh.
        transfer: where its corners get their values from.
        seams: (S, 2) int64, the seams of that.
        device: Warp device.
    """

    def __init__(
        self,
        faces: npt.NDArray[np.int32],
        result: SimplifiedMesh,
        transfer: SurfaceTransfer,
        seams: npt.NDArray[np.int64],
        device: str,
    ) -> None:
        self._device, self._faces = device, result.faces
        self._weights = SAMPLES_OF_FEW if len(result.faces) <= FEW_FACES else SAMPLES
        cut = cut_surface(faces, seams, None if result.repair is None else result.repair.sheets)
        self._used, self._vertex = cut.face, cut.vertex
        # Faces of the cut surface by those of the input; each corner starts on one.
        self._place = np.full(len(faces) + 1, -1, dtype=np.int32)
        self._place[self._used] = np.arange(len(self._used), dtype=np.int32)
        # A mended mesh has some faces the other way round, and so has the output.
        self._turned = np.zeros(len(faces), dtype=bool) if result.repair is None else result.repair.is_turned
        corner = cut.corner
        if self._turned.any():
            corner = np.where(self._turned[:, None], corner[:, ::-1], corner)
        if len(self._used) < len(corner):
            corner = corner[self._used]
        start = self._place[transfer.wedge_face][transfer.corner_wedge]
        with device_turn(device):
            corner_vertex = new_arrays.uploaded(corner.ravel(), dtype=wp.int32, device=device)
            unknown = new_arrays.zeros((1, len(self._vertex)), dtype=wp.vec3, device=device)
            self._surface = make_surface(unknown, corner_vertex, build_adjacency(corner_vertex, len(self._vertex)))
            self._start = new_arrays.uploaded(start.ravel(), dtype=wp.int32, device=device)
            self._corner_vertex = new_arrays.uploaded(result.faces.ravel(), dtype=wp.int32, device=device)
            self._samples = new_arrays.uploaded(self._weights, dtype=wp.vec3, device=device)

    def find(
        self, points: npt.NDArray[np.floating], placed: npt.NDArray[np.floating], near: Partners | None = None
    ) -> Partners:
        """Find them in one pose, downhill from where the corners of the output get their values.

        Args:
            points: (V, 3), the input's pose.
            placed: (V', 3), the output in that pose.
            near: partners in another pose, which the search starts from.
        """
        device, shape = self._device, (len(self._faces), len(self._weights))
        pose, placed = points.astype(np.float64), placed.astype(np.float64)
        # About the pose's middle, and parts of its size, so that single precision does.
        # Axis by axis: NumPy takes three times as long along rows of three.
        low, high = (np.array([pick(axis) for axis in pose.T]) for pick in (np.min, np.max))
        middle, size = (low + high) / 2, float(np.linalg.norm(high - low)) or 1.0
        pose, placed = (pose - middle) / size, (placed - middle) / size
        known = np.full(shape, -1, dtype=np.int32) if near is None else self._place[near.face_on_host]
        with device_turn(device):
            self._surface.points = new_arrays.uploaded(pose[self._vertex][None], dtype=wp.vec3, device=device)
            partner = new_arrays.empty(shape, dtype=wp.int32, device=device)
            weight = new_arrays.zeros(shape, dtype=wp.vec3, device=device)
            launch_in_parts(
                kernels.find_partners,
                shape,
                [
                    FIRST_ITEM,
                    self._surface,
                    self._start,
                    new_arrays.uploaded(known, dtype=wp.int32, device=device),
                    self._corner_vertex,
                    new_arrays.uploaded(placed, dtype=wp.vec3, device=device),
                    self._samples,
                ],
                [partner, weight],
                device=device,
            )
            if len(self._used) < len(self._turned):
                partner = new_arrays.uploaded(np.append(self._used, -1)[partner.numpy()], dtype=wp.int32, device=device)
            if self._turned.any():
                found, of_corner = partner.numpy(), weight.numpy()
                weight.assign(np.where(self._turned[found][..., None], of_corner[..., ::-1], of_corner))
        area = _doubled_areas(placed, self._faces)
        return Partners(partner, weight, area / (area.max(initial=0.0) or 1.0), self._weights, device)


def _doubled_areas(points: npt.NDArray[np.floating], faces: npt.NDArray[np.int32]) -> Floats:
    """Twice the areas (N,) of faces (N, 3): what NumPy's cross products and norms give, column by column."""
    a, b, c = (points[faces[:, k]].T for k in range(3))
    (u, v, w), (x, y, z) = b - a, c - a
    one, two, three = v * z - w * y, w * x - u * z, u * y - v * x
    areas: Floats = np.sqrt(one * one + two * two + three * three)
    return areas
