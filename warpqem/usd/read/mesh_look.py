"""What a mesh of a stage looks like: its display colours, or what its material gives, and its normals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom

from warpqem.errors import StageError
from warpqem.measure.surface_values import SurfaceValues
from warpqem.mesh.directions import unit_vectors
from warpqem.picture.look import PLAIN, Look, Part, Texture
from warpqem.usd.read.descendants import subsets_of
from warpqem.usd.read.materials import Materials, Surface
from warpqem.usd.read.normal_textures import NormalTextures, mapped_normals
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.surface_values import surface_values

__all__ = ["mesh_look"]


def mesh_look(
    source: MeshSource, materials: Materials, time: float | None = None, textures: NormalTextures | None = None
) -> Look:
    """The look of one mesh, at the corners of its triangles in counter-clockwise winding.

    A material of UsdPreviewSurface goes before display colours, and that of a face subset before that of the mesh.

    Args:
        source: The mesh.
        materials: What was read before.
        time: Time code; None for the default time.
        textures: Normal maps that were read before; None to leave them out.
    """
    normals: npt.NDArray[np.floating] | None
    values = surface_values(source, None if time is None else [time])
    polygons = source.topology.triangle_polygons
    count = len(polygons)
    face_surface, surfaces = _surfaces(source, materials, polygons)
    parts: list[Part] = []
    images: list[Texture] = []
    face_part = np.zeros(count, dtype=np.int64)
    colors = np.broadcast_to(np.array(PLAIN, dtype=np.float32), (count, 3, 3)).copy()
    uvs = np.zeros((count, 3, 2), dtype=np.float32)
    colored = False
    for index, surface in enumerate(surfaces):
        faces = np.flatnonzero(face_surface == index)
        if not len(faces):
            continue
        face_part[faces] = len(parts)
        texture, coordinates = _texture(surface, values, faces, count)
        parts.append(Part(source.path, None if texture is None else len(images)))
        if texture is not None and coordinates is not None:
            images.append(texture)
            uvs[faces] = coordinates
        found = _colors(surface, values, faces, count)
        if found is not None:
            colors[faces], colored = found, True
    if source.mesh.GetSubdivisionSchemeAttr().Get() != UsdGeom.Tokens.none:
        # Smooth wherever it is not creased, whatever normals it has: those are of polygons.
        normals = np.broadcast_to(np.array([0.0, 0.0, 1.0], dtype=np.float32), (count, 3, 3))
    else:
        normals = None if values.normals is None else values.normals.at(0, count, 3)
    look = Look(
        face_part,
        parts or [Part(source.path)],
        images,
        colors if colored else None,
        uvs if images else None,
        normals,
    )
    return look if textures is None else _with_maps(look, source, values, materials, textures)


def _with_maps(
    look: Look, source: MeshSource, values: SurfaceValues, materials: Materials, textures: NormalTextures
) -> Look:
    """The look with the normal maps of the mesh, on its normals at the time that these are of."""
    code = Usd.TimeCode.EarliestTime()
    points = np.asarray(source.mesh.GetPointsAttr().Get(code), dtype=np.float64)
    faces = source.topology.triangles
    corners = points[faces[:, ::-1] if source.left_handed else faces]
    given = values.normals
    normals = np.zeros_like(corners) if given is None else unit_vectors(given.at(0, len(corners), 3))
    if given is None and source.mesh.GetSubdivisionSchemeAttr().Get() == UsdGeom.Tokens.none:
        # Without normals it is shaded face by face.
        flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals = np.broadcast_to(unit_vectors(flat)[:, None], corners.shape)
    try:
        mapped = mapped_normals(source, values, normals, textures)
    except StageError as error:
        materials.leave_out(f"{source.path}: {error}")
        return look
    return look if mapped is None else replace(look, mapped=mapped, rest_corners=corners)


def _surfaces(
    source: MeshSource, materials: Materials, polygons: npt.NDArray[np.integer]
) -> tuple[npt.NDArray[np.int64], list[Surface | None]]:
    """Which surface each triangle has, and what these are: that of the mesh first, then those of its subsets."""
    surfaces = [materials.surface_of(source.prim)]
    polygon_surface = np.zeros(source.topology.polygon_count, dtype=np.int64)
    for subset in subsets_of(source.mesh):
        if subset.GetElementTypeAttr().Get() != UsdGeom.Tokens.face:
            continue
        found = materials.surface_of(subset.GetPrim())
        if found is None or found is surfaces[0]:
            continue
        members = np.asarray(subset.GetIndicesAttr().Get() or (), dtype=np.int64)
        polygon_surface[members[(members >= 0) & (members < len(polygon_surface))]] = len(surfaces)
        surfaces.append(found)
    return polygon_surface[polygons], surfaces


def _texture(
    surface: Surface | None, values: SurfaceValues, faces: npt.NDArray[np.integer], count: int
) -> tuple[Texture | None, npt.NDArray[np.floating] | None]:
    """The texture of some faces and its coordinates at their corners; None where the mesh has none of that name."""
    use = None if surface is None else surface.texture
    coordinates = None if use is None else values.uvs.get(use.primvar)
    if use is None or coordinates is None:
        return None, None
    corners = coordinates.at(0, count, 2)[faces]
    rows = np.concatenate([corners, np.ones((*corners.shape[:2], 1))], axis=2)
    return use.texture, rows @ use.transform


def _colors(
    surface: Surface | None, values: SurfaceValues, faces: npt.NDArray[np.integer], count: int
) -> npt.NDArray[np.floating] | None:
    """Linear colours at the corners of some faces; None for plain ones."""
    if surface is not None and surface.color is not None:
        if surface.texture is None or surface.texture.primvar in values.uvs:
            return np.broadcast_to(np.array(surface.color, dtype=np.float32), (len(faces), 3, 3))
        return None
    name = "displayColor" if surface is None or not surface.primvar else surface.primvar
    found = values.colors.get(name)
    return None if found is None else found.at(0, count, 3)[faces]
