"""Normal maps on a mesh: their vectors, their pixels, and what kernels read of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.arguments.array_record import ArrayRecord
from warpqem.kernels import texture as kernels
from warpqem.normal_maps.tangents import corner_tangents

__all__ = ["MappedNormals", "NormalMap", "decoded", "device_maps", "encoded"]

# A byte of 128 stands for no tilt, as near to it as bytes come: two times 128 / 255, less 1, is 0.004.
FULL = 255.0


@dataclass(frozen=True, eq=False, repr=False)
class NormalMap(ArrayRecord):
    """One map.

    Attributes:
        vectors: (height, width, 3) float32 in tangent space, the top row first.
        repeats: whether it repeats beyond its left and right, and its lower and upper border; else its last ones do.
    """

    vectors: npt.NDArray[np.float32]
    repeats: tuple[bool, bool] = (False, False)


@dataclass(frozen=True, eq=False, repr=False)
class MappedNormals(ArrayRecord):
    """Maps on a mesh of N triangles, and the normals that they tilt.

    Attributes:
        maps: T of them.
        face_map: (N,) which of them each face has, -1 for none.
        normals: (N, 3, 3) shading normals at the corners, of length one.
        uvs: (N, 3, 2) where maps lie, from the lower left.
        frame_uvs: (N, 3, 2) the coordinates that tangents follow; None for `uvs`.
    """

    maps: Sequence[NormalMap]
    face_map: npt.NDArray[np.integer]
    normals: npt.NDArray[np.floating]
    uvs: npt.NDArray[np.floating]
    frame_uvs: npt.NDArray[np.floating] | None = None


def encoded(vectors: npt.NDArray[np.floating]) -> npt.NDArray[np.uint8]:
    """Pixels (..., 3) of unit vectors in tangent space, from -1 to 1."""
    share = (np.clip(vectors, -1.0, 1.0) + 1.0) / 2.0
    pixels: npt.NDArray[np.uint8] = np.floor(share * FULL + 0.5).astype(np.uint8)
    return pixels


def decoded(pixels: npt.NDArray[np.uint8]) -> npt.NDArray[np.float32]:
    """Vectors of pixels, as a texture with scale 2 and bias -1 gives them."""
    vectors: npt.NDArray[np.float32] = (pixels * (2.0 / FULL) - 1.0).astype(np.float32)
    return vectors


def device_maps(mapped: MappedNormals | None, corners: npt.NDArray[np.floating], device: str) -> kernels.NormalMaps:
    """What kernels read of the maps on triangles at these corners (N, 3, 3); nothing for None."""
    maps = kernels.NormalMaps()
    if mapped is None or not mapped.maps:
        maps.face_map = wp.array(np.full(len(corners), -1), dtype=wp.int32, device=device)
        return maps
    frame_uvs = mapped.uvs if mapped.frame_uvs is None else mapped.frame_uvs
    tangents = corner_tangents(corners, mapped.normals, frame_uvs)
    maps.face_map = wp.array(np.ascontiguousarray(mapped.face_map), dtype=wp.int32, device=device)
    maps.tangent = wp.array(tangents.reshape(-1, 4), dtype=wp.vec4, device=device)
    maps.uv = wp.array(np.ascontiguousarray(mapped.uvs).reshape(-1, 2), dtype=wp.vec2, device=device)
    texels = [found.vectors.reshape(-1, 3) for found in mapped.maps]
    starts = np.cumsum([0, *(len(one) for one in texels[:-1])])
    maps.texel = wp.array(np.concatenate(texels), dtype=wp.vec3, device=device)
    maps.start = wp.array(starts, dtype=wp.int32, device=device)
    sizes = np.array([found.vectors.shape[1::-1] for found in mapped.maps])
    maps.size = wp.array(sizes, dtype=wp.vec2i, device=device)
    maps.repeats = wp.array(np.array([found.repeats for found in mapped.maps], int), dtype=wp.vec2i, device=device)
    return maps
