"""Texture coordinates on a mesh: their seams and islands, how a texture is stretched, and where seams run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.kernels.binding import find_nearest_segments
from warpqem.mesh.components import lowest_members
from warpqem.mesh.edges import edge_key
from warpqem.runtime.launches import launch

__all__ = ["Chart", "Stretch", "draw_seam_samples", "make_chart", "segment_distances", "texture_jacobians"]

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

# Two faces have the same texture coordinates at an edge where those differ by less than this part of their extent:
# above the rounding of half floats, which some files hold, below a texel of a large texture.
SAME_UV = 1e-4

# A face whose texture coordinates cover less than this part of their squared extent has no texture to be stretched.
NO_AREA = 1e-14

# Faces that stretch is taken from at most; on more, so many are drawn, which gives it to about half a percent.
STRETCH_FACES = 20000


@dataclass(frozen=True)
class Chart:
    """How texture coordinates cut a mesh.

    Attributes:
        island: (N,) int64, faces that are joined through edges that are no seams have the same number, from 0 on.
        seam: (E, 2) int64, the ends of each seam edge as corners (0 to 3N).
    """

    island: Ints
    seam: Ints


def make_chart(place: Ints, uv: Floats) -> Chart:
    """Seams and islands.

    An edge is a seam where two faces meet that have different coordinates there; the border of the mesh is none.

    Args:
        place: (N, 3), equal numbers for corners at the same place, whatever vertex they are.
        uv: (N, 3, 2).
    """
    corner = np.arange(place.size)
    following = corner - corner % 3 + (corner + 1) % 3
    flat, values = place.ravel(), uv.reshape(-1, 2)
    upwards = flat[corner] < flat[following]
    low, high = np.where(upwards, corner, following), np.where(upwards, following, corner)
    key = edge_key(flat[low], flat[high], int(flat.max()) + 1)
    order = np.argsort(key, kind="stable")
    order = order[flat[low[order]] != flat[high[order]]]
    pair = np.flatnonzero(key[order[1:]] == key[order[:-1]])
    one, other = order[pair], order[pair + 1]
    tolerance = SAME_UV * np.ptp(values, axis=0).max(initial=0.0)
    apart = [np.abs(values[end[one]] - values[end[other]]).max(axis=1, initial=0.0) for end in (low, high)]
    cut = np.maximum(*apart) > tolerance
    joined = np.stack([one[~cut], other[~cut]], axis=1) // 3
    _, island = np.unique(lowest_members(len(place), joined), return_inverse=True)
    return Chart(island.ravel(), np.stack([low[one[cut]], high[one[cut]]], axis=1))


def texture_jacobians(corners: Floats, uv: Floats) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """How the surface moves with its texture coordinates: (S, 3, 2) of faces (S, 3, 3) with coordinates (S, 3, 2).

    Returns:
        The Jacobians, 0 where there is none, and (S,) where there is one: where the coordinates cover some area.
    """
    edges = corners[:, 1:] - corners[:, :1]
    uv_edges = uv[:, 1:] - uv[:, :1]
    (du1, dv1), (du2, dv2) = uv_edges[:, 0].T, uv_edges[:, 1].T
    twice_area = du1 * dv2 - du2 * dv1
    extent = np.ptp(uv.reshape(-1, 2), axis=0).max(initial=0.0) if len(uv) else 0.0
    valid = np.abs(twice_area) > NO_AREA * extent**2
    inverse = np.stack([dv2, -dv1, -du2, du1], axis=1).reshape(-1, 2, 2)
    inverse = inverse / np.where(valid, twice_area, np.inf)[:, None, None]
    jacobian: Floats = np.einsum("sek,sew->skw", edges, inverse.transpose(0, 2, 1))
    return jacobian, valid


class Stretch:
    """Mean over the frames of a mesh's texture stretch.

    The L2 norm of Sander, Snyder, Gortler and Hoppe, "Texture Mapping Progressive Meshes" (2001), section 3: the root
    mean square length that a unit of texture has on the surface, over all directions and the surface's area, with the
    texture scaled to the surface's area. 1 is the least; mirrored islands count as others do.
    """

    def __init__(self, faces: Ints, seed: int) -> None:
        """For a mesh with faces (N, 3)."""
        chosen = np.arange(len(faces))
        if len(faces) > STRETCH_FACES:
            chosen = np.sort(np.random.default_rng(seed).choice(len(faces), STRETCH_FACES, replace=False))
        self._chosen, self._faces = chosen, faces[chosen]
        self._sum, self._count = 0.0, 0

    def add(self, points: Floats, uv: Floats) -> None:
        """Take a frame: points (V, 3), coordinates (N, 3, 2)."""
        corners, uv = points[self._faces], uv[self._chosen]
        jacobian, valid = texture_jacobians(corners, uv)
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        u, v = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
        uv_area = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
        valid &= area > 0
        if valid.any():
            squared = (jacobian[valid] ** 2).sum(axis=(1, 2)) / 2
            mean = (squared * area[valid]).sum() / area[valid].sum()
            self._sum += float(np.sqrt(mean * uv_area[valid].sum() / area[valid].sum()))
            self._count += 1

    def mean(self) -> float | None:
        """The value; None where no face has both an area and texture coordinates that cover one."""
        return self._sum / self._count if self._count else None


def draw_seam_samples(points: Floats, faces: Ints, chart: Chart, count: int, seed: int) -> tuple[Ints, Floats]:
    """Points of the seams, evenly spread over their length: edge (S,) and the part of the way along it (S,).

    Args:
        points: (V, 3) of the frame in which lengths are taken.
        faces: (N, 3).
        chart: with at least one seam.
        count: how many.
        seed: of the random start.
    """
    start, end = (points[faces.ravel()[chart.seam[:, k]]] for k in (0, 1))
    length = np.linalg.norm(end - start, axis=1)
    total = np.cumsum(length)
    if total[-1] == 0:
        return np.arange(len(length)), np.zeros(len(length))
    at = (np.arange(count) + np.random.default_rng(seed).random()) / count * total[-1]
    edge = np.searchsorted(total, at, side="right").clip(0, len(length) - 1)
    along = (at - (total[edge] - length[edge])) / np.where(length[edge] > 0, length[edge], 1.0)
    return edge, along.clip(0, 1)


def segment_distances(query: Floats, start: Floats, end: Floats, device: str) -> Floats:
    """Distances (S,) from points (S, 3) to the nearest of segments (E, 3) to (E, 3)."""
    distance = wp.empty(len(query), dtype=wp.float64, device=device)
    launch(
        find_nearest_segments,
        dim=len(query),
        inputs=[wp.array(values, dtype=wp.vec3d, device=device) for values in (query, start, end)],
        outputs=[distance],
        device=device,
    )
    found: Floats = distance.numpy()
    return found
