"""Normal maps baked: what a surface shades with, as a texture of a coarser one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.arguments.array_record import ArrayRecord
from warpqem.kernels import normal_bake as kernels
from warpqem.normal_maps.maps import MappedNormals, device_maps, encoded
from warpqem.normal_maps.tangents import corner_tangents
from warpqem.runtime.device import on_device
from warpqem.runtime.part_launches import FIRST_ITEM, launch_in_parts

__all__ = ["BakeSurface", "BakedMap", "bake_normals", "overlap_share"]

# Points across a texel, each way: what is finer than a texel becomes its mean.
SAMPLES = 2
# Texels that islands grow by: as far as the fourth level of smaller copies of a texture reaches.
MARGIN = 16


@dataclass(frozen=True, eq=False, repr=False)
class BakeSurface(ArrayRecord):
    """Triangles that normals come from, or that get a map.

    Attributes:
        corners: (N, 3, 3) their points, counter-clockwise seen from the front.
        normals: (N, 3, 3) shading normals there, of length one.
        part: (N,) integers; faces look for those of their own part alone.
        uvs: (N, 3, 2) where the map lies on them, from 0 to 1; None for a surface without one.
        mapped: normal maps that it has already; None for none.
    """

    corners: npt.NDArray[np.floating]
    normals: npt.NDArray[np.floating]
    part: npt.NDArray[np.integer]
    uvs: npt.NDArray[np.floating] | None = None
    mapped: MappedNormals | None = None


@dataclass(frozen=True, eq=False, repr=False)
class BakedMap(ArrayRecord):
    """A map.

    Attributes:
        pixels: (size, size, 3) uint8, the top row first: a vector in tangent space, plus 1, times 127.5.
        filled: (size, size) bool, texels that a face is on.
    """

    pixels: npt.NDArray[np.uint8]
    filled: npt.NDArray[np.bool_]


@on_device
def overlap_share(uvs: npt.NDArray[np.floating], size: int, *, device: str) -> float:
    """Part of the texels under triangles (N, 3, 2) that are under two of them or more; 0 where none is under any."""
    output = kernels.Output()
    meshes = _place_uvs(output, uvs, device)
    count = wp.empty((size, size), dtype=wp.int32, device=device)
    launch_in_parts(kernels.count_faces_at_texels, count.shape, [FIRST_ITEM, output], [count], device=device)
    found = count.numpy()
    del meshes
    return float((found > 1).sum() / max((found > 0).sum(), 1))


@on_device
def bake_normals(output: BakeSurface, source: BakeSurface, size: int, *, device: str) -> BakedMap:
    """Bake the normals of a surface into a map of another one.

    From each point of the output a ray goes both ways along its normal; of the faces of its part that face the same
    side, the nearest one gives its normal. Where the ray meets none, or one that is much further than the nearest point
    is, that point does.

    Args:
        output: what gets the map; has `uvs`.
        source: what it is to look like.
        size: texels across the map.
        device: Warp device.
    """
    assert output.uvs is not None
    centre, scale = _unit_box(source.corners)

    def at_corners(values: npt.NDArray[np.floating], dtype: type = wp.vec3) -> wp.array:
        flat = np.ascontiguousarray(values, dtype=np.float32).reshape(-1, values.shape[-1])
        return wp.array(flat, dtype=dtype, device=device)

    target = kernels.Output()
    meshes = [_place_uvs(target, output.uvs, device)]
    target.position = at_corners((output.corners - centre) * scale)
    target.normal = at_corners(output.normals)
    target.tangent = at_corners(corner_tangents(output.corners, output.normals, output.uvs), wp.vec4)
    target.part = wp.array(np.ascontiguousarray(output.part), dtype=wp.int32, device=device)
    given = kernels.Input()
    given.position, given.normal = at_corners((source.corners - centre) * scale), at_corners(source.normals)
    given.part = wp.array(np.ascontiguousarray(source.part), dtype=wp.int32, device=device)
    given.maps = device_maps(source.mapped, source.corners, device)
    corner = wp.array(np.arange(source.part.size * 3), dtype=wp.int32, device=device)
    meshes.append(wp.Mesh(points=given.position, indices=corner))
    given.mesh = meshes[-1].id
    normal = wp.empty((size, size), dtype=wp.vec3, device=device)
    filled = wp.empty((size, size), dtype=wp.int32, device=device)
    launch_in_parts(
        kernels.bake_texels,
        normal.shape,
        [FIRST_ITEM, target, given, SAMPLES],
        [normal, filled],
        device=device,
    )
    covered = filled.numpy() > 0
    del meshes
    return BakedMap(encoded(dilated(normal, filled, MARGIN, device)), covered)


def dilated(normal: wp.array, filled: wp.array, rounds: int, device: str) -> npt.NDArray[np.float32]:
    """Grow filled texels by some texels; the rest is not tilted."""
    others = wp.empty_like(normal), wp.empty_like(filled)
    for _ in range(rounds):
        launch_in_parts(kernels.dilate, normal.shape, [FIRST_ITEM, normal, filled], list(others), device=device)
        normal, filled, others = *others, (normal, filled)
    flat = np.array([0.0, 0.0, 1.0], dtype=np.float32)
    return np.where(filled.numpy()[..., None] > 0, normal.numpy(), flat)


def _place_uvs(output: kernels.Output, uvs: npt.NDArray[np.floating], device: str) -> wp.Mesh:
    """The triangles in the plane of their texture coordinates, for boxes to find them; held as long as they are."""
    flat = np.ascontiguousarray(uvs, dtype=np.float32).reshape(-1, 2)
    points = np.concatenate([flat, np.zeros((len(flat), 1), dtype=np.float32)], axis=1)
    corner = wp.array(np.arange(len(flat)), dtype=wp.int32, device=device)
    mesh = wp.Mesh(points=wp.array(points, dtype=wp.vec3, device=device), indices=corner)
    output.uv, output.uv_mesh = wp.array(flat, dtype=wp.vec2, device=device), mesh.id
    return mesh


def _unit_box(corners: npt.NDArray[np.floating]) -> tuple[npt.NDArray[np.float64], float]:
    """The middle of some points, and what makes their diagonal 1."""
    points = corners.reshape(-1, 3).astype(np.float64)
    low, high = points.min(axis=0), points.max(axis=0)
    return (low + high) / 2, 1.0 / (float(np.linalg.norm(high - low)) or 1.0)
