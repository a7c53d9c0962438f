"""Normal maps that meshes have already, from the materials of UsdPreviewSurface that are bound to them."""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image
from pxr import UsdGeom, UsdShade

from warpqem.errors import StageError
from warpqem.measure.surface_values import SurfaceValues
from warpqem.normal_maps.maps import MappedNormals, NormalMap
from warpqem.picture.render import decoded_srgb
from warpqem.usd.read.copy_asset import copy_asset
from warpqem.usd.read.descendants import subsets_of
from warpqem.usd.read.materials import IMAGE_ERRORS, coordinates_of, numbers_of, source_of, value_of
from warpqem.usd.read.read_mesh import MeshSource

__all__ = ["NormalTextures", "NormalUse", "face_owners", "mapped_normals"]


@dataclass(frozen=True, eq=False)
class NormalUse:
    """A normal map and how it lies on a surface.

    Attributes:
        map: its vectors.
        primvar: name of the texture coordinates.
        transform: (3, 2), by which rows (u, v, 1) are multiplied.
    """

    map: NormalMap
    primvar: str
    transform: npt.NDArray[np.float64]


class NormalTextures:
    """Reads the normal map of each material once."""

    def __init__(self) -> None:
        """Nothing is read yet."""
        self._uses: dict[tuple[Any, str], NormalUse | None] = {}

    def of(self, material: UsdShade.Material) -> NormalUse | None:
        """The normal map of a material; None without one.

        Raises:
            StageError: there is one that cannot be read.
        """
        key = (material.GetPrim().GetStage(), str(material.GetPath()))
        if key not in self._uses:
            self._uses[key] = _read(material)
        return self._uses[key]


def face_owners(mesh: UsdGeom.Mesh, polygon_count: int) -> list[tuple[Any, npt.NDArray[np.bool_]]]:
    """The prims whose materials faces have: the mesh first, then its face subsets that bind one; and whose is which.

    Args:
        mesh: The mesh.
        polygon_count: How many faces it has.
    """
    subsets = []
    left = np.ones(polygon_count, dtype=bool)
    for subset in subsets_of(mesh):
        binds = UsdShade.MaterialBindingAPI(subset.GetPrim()).GetDirectBinding().GetMaterialPath()
        if subset.GetElementTypeAttr().Get() != UsdGeom.Tokens.face or not binds:
            continue
        index = np.asarray(subset.GetIndicesAttr().Get() or (), dtype=np.int64)
        own = np.zeros(polygon_count, dtype=bool)
        own[index[(index >= 0) & (index < polygon_count)]] = True
        own &= left
        left &= ~own
        subsets.append((subset.GetPrim(), own))
    return [(mesh.GetPrim(), left), *subsets]


def mapped_normals(
    source: MeshSource, values: SurfaceValues, normals: npt.NDArray[np.floating], textures: NormalTextures
) -> MappedNormals | None:
    """The normal maps of a mesh, and where they lie on its N triangles in counter-clockwise winding; None without any.

    Args:
        source: The mesh.
        values: Its texture coordinates.
        normals: (N, 3, 3) what it is shaded by without them.
        textures: What was read before.

    Raises:
        StageError: a map cannot be read, or the mesh lacks the coordinates that it lies on.
    """
    polygons = source.topology.triangle_polygons
    count = len(polygons)
    maps: list[NormalMap] = []
    face_map = np.full(count, -1, dtype=np.int64)
    uvs, frame_uvs = np.zeros((count, 3, 2)), np.zeros((count, 3, 2))
    for prim, owned in face_owners(source.mesh, source.topology.polygon_count):
        faces = np.flatnonzero(owned[polygons])
        material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
        use = textures.of(material) if material and len(faces) else None
        if use is None:
            continue
        if use.primvar not in values.uvs:
            raise StageError(f"the normal map of {material.GetPath()} lies on primvars:{use.primvar}, which is none")
        corners = values.uvs[use.primvar].at(0, count, 2)[faces]
        rows = np.concatenate([corners, np.ones((*corners.shape[:2], 1))], axis=2)
        uvs[faces], frame_uvs[faces], face_map[faces] = rows @ use.transform, corners, len(maps)
        maps.append(use.map)
    return MappedNormals(maps, face_map, normals, uvs, frame_uvs) if maps else None


def _read(material: UsdShade.Material) -> NormalUse | None:
    shader = material.ComputeSurfaceSource()[0]
    if not shader or shader.GetIdAttr().Get() != "UsdPreviewSurface":
        return None
    port = shader.GetInput("normal")
    node = source_of(port) if port else None
    if not isinstance(node, UsdShade.Shader):
        # A constant is the same everywhere, and means no tilt.
        return None
    start = f"the normal map of {material.GetPath()}"
    if node.GetIdAttr().Get() != "UsdUVTexture":
        raise StageError(f"{start} comes from {node.GetPath()}, which is no UsdUVTexture")
    asset = value_of(node, "file")
    name = getattr(asset, "path", "") or "none"
    place = str(getattr(asset, "resolvedPath", "") or "")
    if not place:
        raise StageError(f"{start}, {name}, " + ("is a set of tiles" if "<UDIM>" in name else "is missing"))
    primvar, transform = coordinates_of(node)
    wraps = [str(value_of(node, wrap) or "") not in ("clamp", "black") for wrap in ("wrapS", "wrapT")]
    return NormalUse(NormalMap(_vectors(node, place, start), (wraps[0], wraps[1])), primvar, transform)


def _vectors(node: UsdShade.Shader, place: str, start: str) -> npt.NDArray[np.float32]:
    """The values that a texture gives a surface, as a renderer reads them: (height, width, 3)."""
    file = io.BytesIO()
    try:
        copy_asset(place, file)
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            pixels = np.array(Image.open(file).convert("RGB"))
    except (StageError, *IMAGE_ERRORS) as error:
        raise StageError(f"{start}, {place}, is no image that can be read") from error
    decode: Callable[[Any], Any] = (
        (lambda p: p / 255.0) if value_of(node, "sourceColorSpace") == "raw" else decoded_srgb
    )
    scale = numbers_of(value_of(node, "scale"), 3) or [1.0] * 3
    bias = numbers_of(value_of(node, "bias"), 3) or [0.0] * 3
    vectors: npt.NDArray[np.float32] = (decode(pixels) * scale + bias).astype(np.float32)
    return vectors
